"""`hilbench sdo dump|load|diff`: the whole configuration of a device as a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from typer import Argument, Option

from hilbench.apps.cli.options import (
    SDO_TIMEOUT_S,
    BusOption,
    ConfigOption,
    EdsOption,
    ForceOption,
    JsonOption,
    NodeArgument,
    TimeoutOption,
    print_json,
)
from hilbench.apps.cli.tables import table
from hilbench.errors import EXIT_CRITERION_FAILED, BenchFaultError, UnusableInputError

if TYPE_CHECKING:
    from canopen import ObjectDictionary
    from hilbench.canopen.device_configuration import Configuration, Difference, Key
    from hilbench.canopen.master import Master

_SAVE = int.from_bytes(b"save", "little")
_FILES = (".dcf", ".eds", ".bin", ".cdcf")


def dump(
    node: NodeArgument,
    file: Annotated[Path, Argument(metavar="FILE", help="DCF to write (.dcf), or concise DCF (.bin, .cdcf)")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    timeout: TimeoutOption = SDO_TIMEOUT_S,
) -> None:
    """Read all objects of a node and keep them as a DCF: its EDS file with the values (ParameterValue, CiA 306).

    A concise DCF (CiA 302-3) has the settings alone, in the order in which a device accepts them. Objects that could
    not be read are named with the reason; --timeout gives slow ones more time.

    Example: hilbench sdo dump 1 axis1.dcf --bus socketcan:can0
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import is_concise, write_concise, write_dcf

    with BusSession(config, bus) as on:
        master, node_id, _, od = on.device(node, eds, timeout)
        found = _read(master, node_id, od)
    (write_concise if is_concise(file) else write_dcf)(found, file)
    print(f"{file}: {len(found.values)} objects of node {node_id}")
    for key, why in found.refused.items():
        print(f"not read: {found.name(key)}: {why}")


def load(
    node: NodeArgument,
    file: Annotated[Path, Argument(metavar="FILE", help="DCF (.dcf) or concise DCF (.bin, .cdcf)")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    store: Annotated[bool, Option("--store", help="let the device keep it over a loss of power (1010h sub 1)")] = False,
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    force: ForceOption = False,
) -> None:
    """Write a configuration to a node, and read back what it has then; commands and set points are left out.

    Of a DCF that was made for another node id, the COB-IDs that carry it get this node's.

    Exit code: 0 all of it is there, 1 some objects were refused, kept another value or were not answered, or it could
    not be stored, 3 the node does not answer.

    Example: hilbench sdo load 1 axis1.dcf --bus socketcan:can0 --store
    """
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import Configuration, moved, node_of_file, write_device, writes_of_file

    with BusSession(config, bus) as on:
        on.be_only_master(f"sdo load to node {node}", force=force)
        master, node_id, _, od = on.device(node, eds, timeout, _description(file))
        made_for = node_of_file(file)
        writes, renamed = moved(writes_of_file(file, od), made_for or node_id, node_id)
        with _progress(f"node {node_id}") as progress:
            failed = write_device(master, node_id, writes, progress)
        not_stored = _store(master, node_id, failed) if store else None
    objects = len({write.key for write in writes})
    print(f"node {node_id}: {objects - len(failed)} of {objects} objects as in {file}")
    if renamed:
        print(f"{len(renamed)} COB-IDs of node {made_for} became those of node {node_id}")
    for key, why in failed.items():
        print(f"{Configuration(od).name(key)}: {why}")
    if not_stored is not None:
        print(f"not stored: {not_stored}")
    if failed or not_stored is not None:
        raise typer.Exit(EXIT_CRITERION_FAILED)


def _store(master: Master, node_id: int, failed: Mapping[Key, str]) -> str | None:
    """Why the device does not keep it; None: it does."""
    if failed:
        return "the device is not as the file has it"
    if not master.has(node_id, 0x1010, 1):
        return "its EDS file has no object 1010h sub 1, by which a device stores its parameters"
    try:
        master.sdo_write(node_id, 0x1010, _SAVE, 1)
    except BenchFaultError as error:
        return str(error)
    return None


def diff(
    first: Annotated[str, Argument(metavar="FIRST", help="node (id, or name with --config) or file")],
    second: Annotated[str, Argument(metavar="SECOND", help="node or file")],
    config: ConfigOption = None,
    bus: BusOption = None,
    eds: EdsOption = Path("eds"),
    everything: Annotated[
        bool, Option("--all", help="also objects that are no settings, and those that one side lacks")
    ] = False,
    timeout: TimeoutOption = SDO_TIMEOUT_S,
    json: JsonOption = False,
) -> None:
    """Compare the settings of two devices, a device with a file, or two files.

    Exit code: 0 no difference, 1 differences.

    Example: hilbench sdo diff 1 axis1.dcf --bus socketcan:can0

    Example: hilbench sdo diff axis1.dcf axis2.dcf
    """
    from hilbench.canopen.device_configuration import differences

    both = _both(first, second, config, bus, eds, timeout)
    found = differences(*both, all_objects=everything)
    if json:
        rows = [{**asdict(row), "key": f"{row.key[0]:04X}h:{row.key[1]}"} for row in found]
        print_json(rows, ensure_ascii=False)
    else:
        _show(found, first, second)
    raise typer.Exit(EXIT_CRITERION_FAILED if found else 0)


def _both(
    first: str, second: str, config: Path | None, bus: str | None, eds: Path, timeout_s: float
) -> tuple[Configuration, Configuration]:
    """The two sides; a concise DCF is read with the objects of the other side."""
    from hilbench.apps.canopen_tools.attach import BusSession
    from hilbench.canopen.device_configuration import is_concise, read_file
    from hilbench.canopen.eds import load_eds

    sides: dict[str, Configuration] = {}
    files = [name for name in (first, second) if Path(name).suffix.lower() in _FILES]
    dcf = next((found for name in files if (found := _description(Path(name)))), None)
    for name in (first, second):
        if name in files:
            continue
        with BusSession(config, bus) as on:
            master, node_id, _, od = on.device(name, eds, timeout_s, dcf)
            sides[name] = _read(master, node_id, od)
    for name in sorted(files, key=lambda name: is_concise(Path(name))):
        if sides:
            od = next(iter(sides.values())).od
        elif is_concise(Path(name)):
            raise UnusableInputError(name, "a concise DCF names no objects, expected a DCF or a node beside it")
        else:
            od = load_eds(Path(name), 0)
        sides[name] = read_file(Path(name), od)
    return sides[first], sides[second]


def _description(file: Path) -> Path | None:
    """The file, if it says what objects there are; a concise DCF has values alone."""
    from hilbench.canopen.device_configuration import is_concise

    return None if is_concise(file) or not file.is_file() else file


def _read(master: Master, node_id: int, od: ObjectDictionary) -> Configuration:
    from hilbench.canopen.device_configuration import read_device

    with _progress(f"node {node_id}") as progress:
        found = read_device(master, node_id, od, progress)
    if not found.values:
        raise BenchFaultError(f"node {node_id}: none of its {len(found.refused)} objects could be read")
    return found


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A bar on the terminal, where there is one."""
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task(what)
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _show(found: Sequence[Difference], first: str, second: str) -> None:
    console = Console(highlight=False)
    if not found:
        console.print(f"{first} and {second} have the same settings", markup=False)
        return
    title = "1 object differs" if len(found) == 1 else f"{len(found)} objects differ"
    rows = [(row.name, row.first or "-", row.second or "-") for row in found]
    console.print(table(("object", first, second), rows, title=title))
