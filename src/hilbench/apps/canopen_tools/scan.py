"""`hilbench scan`: who is on a bus."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from typer import Option

from hilbench.apps.canopen_tools.lss import words
from hilbench.apps.cli.options import BusOption, ConfigOption, JsonOption, print_json
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_CRITERION_FAILED, EXIT_PASSED

if TYPE_CHECKING:
    from hilbench.apps.canopen_tools.bus_scan import Scan, Station
    from hilbench.runs.config import ExperimentConfig

_SDO_TIMEOUT_S = 0.3
_LSS_TIMEOUT_S = 0.1


def scan(
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: Annotated[Path, Option(help="folder of EDS files that devices are compared with")] = Path("eds"),
    listen: Annotated[float, Option(min=0.0, metavar="S", help="how long to listen first")] = 1.0,
    ask: Annotated[bool, Option(help="ask every node id by SDO, or only listen")] = True,
    lss: Annotated[
        bool, Option("--lss", help="look for devices without a node id too (LSS fastscan, 10 s for each)")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Show who is on the bus: node id, NMT state, drive state, identity, firmware, EDS file. Writes nothing.

    While another master is at work on the bus (a bench, or one received) it only listens. With --config, nodes of
    the bench that are missing, or are other devices than their EDS files say, give exit code 1.

    Example: hilbench scan --bus socketcan:can0

    Example: hilbench scan --config bench_configs/web_section_step.yaml --json

    Example: hilbench scan --bus socketcan:can0 --lss
    """
    from hilbench.apps.canopen_tools.attach import BusSession, left_out
    from hilbench.apps.canopen_tools.bus_scan import scan as scan_bus
    from hilbench.apps.canopen_tools.eds_match import EdsFile, eds_files, identity
    from hilbench.apps.canopen_tools.interface import bitrate_of
    from hilbench.can.open import open_python_can
    from hilbench.canopen.eds import load_eds
    from hilbench.canopen.lss_master import LssMaster
    from hilbench.canopen.lss_master import shown as address_of
    from hilbench.canopen.master_guard import master_of

    with BusSession(config, bus) as on:
        bench, address, files = on.bench, on.bus, eds_files(eds, left_out)
        if bench is not None:
            named = {part.node.eds: part.node.node_id for part in bench.parts}
            files = [EdsFile(path, identity(load_eds(path, node_id))) for path, node_id in named.items()] + files
        link, reader = on.link(), on.master(_SDO_TIMEOUT_S)
        claimed_by, rate = master_of(address), bitrate_of(address)
        found = scan_bus(link, reader, files, listen, on.master_id, bitrate=rate, claimed_by=claimed_by, ask=ask)
    nameless = []
    if lss and ask and found.master is None:
        with LssMaster(open_python_can(address), _LSS_TIMEOUT_S) as lss_master:
            nameless = lss_master.find_unconfigured()
    problems = _problems(found, bench) if bench is not None else []
    on_nodes = {} if bench is None else bench.parts_by_node
    parts = {node_id: ", ".join(part.name for part in there) for node_id, there in on_nodes.items()}
    if json:
        print_json(_as_data(found, parts, problems) | {"without_node_id": nameless})
    else:
        _show(found, parts, problems, str(address))
        for device in nameless:
            print(f"no node id: {words(device)}; hilbench lss assign NODE_ID --identity {address_of(device)}")
        if lss and not nameless and found.master is None:
            print("no device without a node id answers")
    raise typer.Exit(EXIT_CRITERION_FAILED if problems else EXIT_PASSED)


def _problems(found: Scan, bench: ExperimentConfig) -> list[str]:
    stations = {station.node_id: station for station in found.stations}
    problems = []
    for part in bench.parts:
        name, node = part.name, part.node
        station = stations.get(node.node_id)
        if station is None:
            problems.append(f"{name} (node {node.node_id}) is not there")
        elif station.device_type is not None and station.eds != node.eds:
            problems.append(
                f"{name} (node {node.node_id}) is {_device(station)}, expected the device of {node.eds.name}"
            )
    return problems


def _as_data(found: Scan, parts: Mapping[int, str], problems: list[str]) -> dict[str, Any]:
    names = ("vendor_id", "product_code", "revision_number", "serial_number")
    stations = [
        {
            **vars(station),
            "identity": dict(zip(names, station.identity, strict=True)),
            "part": parts.get(station.node_id),
        }
        for station in found.stations
    ]
    return {**vars(found), "stations": stations, "master_at_work": found.master is not None, "problems": problems}


def _show(found: Scan, parts: Mapping[int, str], problems: list[str], bus: str) -> None:
    console = Console(highlight=False)
    rows = [
        (
            f"{station.node_id} {parts.get(station.node_id, '')}".rstrip(),
            station.nmt_state or "-",
            station.drive_state or "-",
            _device(station),
            station.firmware or _hex(station.identity[2]),
            "-" if station.eds is None else station.eds.name + ("" if station.eds_of_revision else " (other revision)"),
        )
        for station in found.stations
    ]
    columns = ("node", "NMT state", "drive", "device", "firmware", "EDS")
    console.print(table(columns, rows, ("node",), title=f"{len(found.stations)} nodes on {bus}"))
    if found.waited_s:
        console.print(f"all node ids were asked, sixteen at a time; each had {found.waited_s:.2f} s to answer")
    if found.master is not None:
        console.print(f"no node was asked: another master is active: {found.master}", soft_wrap=True, markup=False)
    for problem in problems:
        console.print(f"[red]error[/red] {problem}", soft_wrap=True)


def _device(station: Station) -> str:
    if station.device_type is None:
        return "-"
    vendor, product = station.identity[:2]
    return f"{station.name or f'CiA {station.device_type & 0xFFFF}'} ({_hex(vendor)}/{_hex(product)})"


def _hex(value: int | None) -> str:
    return "-" if value is None else f"{value:X}h"
