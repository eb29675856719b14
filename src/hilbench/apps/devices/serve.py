"""`hilbench simulate-drive`: any EDS file of a CiA-402 drive is one on a bus."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Final

from hilbench.apps.cli.model_option import model_from
from hilbench.apps.devices.behaviour import Behaviour, load_behaviour
from hilbench.apps.devices.drive import SimulatedDrive
from hilbench.apps.devices.node import SimulatedNode
from hilbench.apps.devices.simulation import hosted, new_clock, simulated_axes
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.identifiers import LAST_NODE
from hilbench.canopen.master_guard import nodes_of_ours
from hilbench.cia402.configuration import place_of
from hilbench.errors import UnusableInputError
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.processes import log, stop_request
from hilbench.real_time import kept_ready

_LOOK_S: Final = 0.05


def serve(
    eds: Path, node: int | None, bus: str, count: int, behaviour: Behaviour, *, lss: bool, serial: int | None
) -> None:
    """Play `count` drives with the node ids from `node` on (with `lss` and no `node`: with none) until SIGINT, SIGTERM
    or SIGHUP.

    Raises UnusableInputError, also when a node with one of the ids is there already.
    """
    node_id = node or 1
    last = node_id + count - 1
    if last > LAST_NODE:
        raise UnusableInputError("--count", f"{count} drives from node {node_id} on, expected ids up to {LAST_NODE}")
    address = BusAddress.parse(bus).as_it_runs() if bus == "embedded" else BusAddress.parse(bus)
    stop, clock = stop_request(), new_clock()
    node_ids = range(node_id, last + 1) if node or not lss else ()
    with nodes_of_ours(address, node_ids, "simulated drive", by_bench=False):
        if lss:
            serials = range(serial or 1, (serial or 1) + count)
            _serve_with_lss(eds, address, list(node_ids) or [None] * count, serials, behaviour, stop)
            return
        nodes = [
            axis
            for number in node_ids
            for axis in simulated_axes(
                eds, number, clock, behaviour, serial_number=None if serial is None else serial + number - node_id
            )
        ]
        for simulated in nodes:
            _introduce(simulated)
        link = open_link(address)
        try:
            time.sleep(behaviour.boot_s)
            with kept_ready(None, log):
                DeviceHost(link, *hosted(nodes, clock)[0]).run(stop)
        finally:
            link.close()


def _serve_with_lss(
    eds: Path,
    address: BusAddress,
    node_ids: Sequence[int | None],
    serials: Iterable[int],
    behaviour: Behaviour,
    stop: Callable[[], bool],
) -> None:
    """Each drive by itself: its node id can become another one at any time."""
    with ExitStack() as playing, kept_ready(None, log):
        for node_id, serial in zip(node_ids, serials, strict=True):
            playing.enter_context(SimulatedDrive(eds, node_id, str(address), behaviour=behaviour, serial_number=serial))
            place = "waits for a node id" if node_id is None else f"node {node_id}"
            print(f"{eds.stem}, serial number {serial}: {place}", flush=True)
        while not stop():
            time.sleep(_LOOK_S)


def behaviour_of(path: Path | None, plant: Path | None) -> Behaviour:
    """Behaviour of drives by the file of --behaviour, with the shaft of --plant. Raises UnusableInputError."""
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
    modes = ", ".join(mode.name.lower().replace("_", " ") for mode in node.modes)
    place = place_of(node.device.node_id, node.axis)
    print(f"{place}: {node.name}; {modes or 'no mode of operation'}", flush=True)
    for assumption in node.assumptions:
        print(f"{place}: {assumption}", flush=True)
