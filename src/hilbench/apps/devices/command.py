"""`hilbench simulate-drive`: drives of any EDS file on a bus."""

from __future__ import annotations

import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from typer import Argument, Option

from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.devices.application import SimulatedNode
    from hilbench.apps.devices.behaviour import Behaviour

_LOOK_S: Final = 0.05


def simulate_drive(
    eds: Annotated[Path, Argument(metavar="EDS", help="EDS or DCF file of a CiA-402 drive")],
    node: Annotated[
        int | None, Option(min=1, max=127, help="node id, of the first of several", show_default="1; with --lss none")
    ] = None,
    bus: Annotated[
        str, Option(help="embedded:NAME, socketcan:vcan0, or another python-can interface:channel")
    ] = "embedded",
    count: Annotated[int, Option(min=1, max=127, help="so many drives, ids in a row")] = 1,
    plant: Annotated[Path | None, Option(help="model file or config of a servo_axis: what the motor turns")] = None,
    behaviour: Annotated[Path | None, Option(help="YAML file: switches, units, and what the drive does wrong")] = None,
    lss: Annotated[
        bool, Option("--lss", help="node ids can be given by LSS; without --node the drives wait for theirs")
    ] = False,
    serial: Annotated[
        int | None,
        Option(
            min=0,
            max=0xFFFF_FFFF,
            help="serial number (1018h sub 4), of the first of several",
            show_default="that of the file; with --lss 1",
        ),
    ] = None,
) -> None:
    """A drive on a bus that is not there: as its EDS file describes it, with CiA 402 behind its objects.

    Example: hilbench simulate-drive eds/hilbench_servo.eds --node 5 --bus socketcan:vcan0
    """
    from hilbench.apps.devices.drive import SimulatedDrive
    from hilbench.apps.devices.simulation import hosted, new_clock, simulated_axes
    from hilbench.can.open import BusAddress, open_link
    from hilbench.canopen.host import DeviceHost
    from hilbench.canopen.identifiers import LAST_NODE
    from hilbench.canopen.master_guard import nodes_of_ours
    from hilbench.processes import log, stop_request
    from hilbench.real_time import kept_ready

    acts, first = _behaviour_of(behaviour, plant), node or 1
    last = first + count - 1
    if last > LAST_NODE:
        raise UnusableInputError("--count", f"{count} drives from node {first} on, expected ids up to {LAST_NODE}")
    address = BusAddress.parse(bus).as_it_runs() if bus == "embedded" else BusAddress.parse(bus)
    stop, clock = stop_request(), new_clock()
    node_ids = range(first, last + 1) if node or not lss else ()
    with nodes_of_ours(address, node_ids, "simulated drive", by_bench=False), ExitStack() as resources:
        if lss:  # each drive by itself: its node id can become another one at any time
            resources.enter_context(kept_ready(None, log))
            ids: list[int | None] = [*node_ids] or [None] * count
            for own, number in enumerate(ids, serial or 1):
                resources.enter_context(SimulatedDrive(eds, number, str(address), behaviour=acts, serial_number=own))
                place = "waits for a node id" if number is None else f"node {number}"
                print(f"{eds.stem}, serial number {own}: {place}", flush=True)
            while not stop():
                time.sleep(_LOOK_S)
            return
        nodes = [
            axis
            for number in node_ids
            for axis in simulated_axes(
                eds, number, clock, acts, serial_number=None if serial is None else serial + number - first
            )
        ]
        for simulated in nodes:
            _introduce(simulated)
        link = resources.enter_context(closing(open_link(address)))
        time.sleep(acts.boot_s)
        with kept_ready(None, log):
            DeviceHost(link, *hosted(nodes, clock)[0]).run(stop)


def _behaviour_of(path: Path | None, plant: Path | None) -> Behaviour:
    """Behaviour of drives by the file of --behaviour, with the shaft of --plant. Raises UnusableInputError."""
    from hilbench.apps.cli.model_option import model_from
    from hilbench.apps.devices.behaviour import Behaviour, load_behaviour
    from hilbench.plant.servo_axis.parameters import ServoAxisParameters

    behaviour = Behaviour() if path is None else load_behaviour(path)
    if plant is None:
        return behaviour
    if behaviour.shaft is not None:
        raise UnusableInputError("--plant", f"{path} has a shaft as well, expected one of the two")
    machine = model_from(plant)
    if not isinstance(machine, ServoAxisParameters):
        raise UnusableInputError(plant, f"the machine is a {machine.kind}, expected a servo_axis")
    return behaviour.model_copy(update={"shaft": machine.shaft})


def _introduce(node: SimulatedNode) -> None:
    from hilbench.cia402.configuration import place_of

    modes = ", ".join(mode.name.lower().replace("_", " ") for mode in node.modes)
    place = place_of(node.device.node_id, node.axis)
    print(f"{place}: {node.name}; {modes or 'no mode of operation'}", flush=True)
    for assumption in node.assumptions:
        print(f"{place}: {assumption}", flush=True)
