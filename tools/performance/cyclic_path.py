"""PDOs of a cycle: the bench's own path beside canopen's PDO objects, on the same frames."""

from __future__ import annotations

import tracemalloc
from typing import Any

import numpy as np

import can
import canopen
from hilbench.can.frame import Frame
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.configuration import default_reader
from hilbench.cia402.drive import DriveGoal
from hilbench.cia402.units import DriveUnits
from hilbench.exchange.addressing import dictionary_of
from hilbench.exchange.nodes import Nodes
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from performance.table import Section, best_cpu_s

_ENABLED = 0x0237  #: statusword of OPERATION ENABLED
_CYCLES = 2000
_TIMES = 7


class _NoBus(can.BusABC):
    """Where canopen's frames go: nowhere."""

    def __init__(self) -> None:
        super().__init__("none")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Take a frame."""


def measure(config: BenchConfig) -> Section:
    """Decode, dispatch and encode a cycle's frames of three drives and the virtual I/O."""
    section = Section(
        "PDO path per cycle",
        "The frames of a cycle of the demo: seven TPDOs in, four RPDOs out. Codec: dispatch by COB-ID, decode every "
        "value, encode every set point, on both sides. The bench's whole path adds units, state machines of the "
        "drives and their supervision.",
    )
    nodes = _nodes(config)
    tpdos = [pdo for part in _parts(nodes) for pdo in nodes.pdo_maps(part.name) if pdo.cob_id in _answers(nodes)]
    tpdos = [pdo for pdo in tpdos if pdo.period == 1]
    rpdos = [*(drive.pdos.rpdo for drive in nodes.drives), *nodes.io.boundary]
    frames = [Frame(pdo.cob_id, _data(pdo)) for pdo in tpdos]
    decoders = {pdo.cob_id: pdo.unpack for pdo in tpdos}
    values = [pdo.unpack(bytes(pdo.size)) for pdo in rpdos]

    def codec() -> None:
        for _ in range(_CYCLES):
            for frame in frames:
                decoders[frame.can_id](frame.data)
            for pdo, setpoints in zip(rpdos, values, strict=True):
                Frame(pdo.cob_id, pdo.pack(setpoints))

    outputs = {"axis1": 3.0, "axis2": 3.0, "load": 1.0, "strain_prev": 2.8e-4, "F_next_N": 70.0}

    def whole_path() -> None:
        for _ in range(_CYCLES):
            nodes.decode(frames)
            nodes.encode(outputs)

    canopens_codec = _canopen(nodes, tpdos, rpdos, frames, values)
    ours, whole, theirs = (best_cpu_s(task, _TIMES) / _CYCLES * 1e6 for task in (codec, whole_path, canopens_codec))
    section.add("codec", ours, "µs")
    section.add("canopen's PDO objects", theirs, "µs", theirs / ours, "codec")
    section.add("the bench's whole path", whole, "µs", theirs / whole, "faster than canopen's codec alone")
    section.add("memory that 2000 cycles of the whole path leave", _growth_bytes(whole_path), "bytes")
    return section


def _growth_bytes(task: Any) -> float:
    task()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    task()
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return float(after - before)


def _nodes(config: BenchConfig) -> Nodes:
    nodes = Nodes(config)
    for drive in nodes.drives:
        drive.units = DriveUnits.from_objects(default_reader(drive.od), {}, drive.settings.name)
        drive.request(DriveGoal.ENABLED)
    return nodes


def _parts(nodes: Nodes) -> list[Part]:
    """Parts that answer the bench: the drives, and the virtual I/O."""
    return [part for part in nodes.config.parts if part.role is not Role.VIRTUAL_AXIS]


def _answers(nodes: Nodes) -> set[int]:
    return {pdo.cob_id for pdo in nodes.expected_pdos()}


def _data(pdo: PdoMap) -> bytes:
    """Statuswords that say OPERATION ENABLED, small numbers elsewhere."""
    return pdo.pack([_ENABLED if variable.index == 0x6041 else 7 for variable in pdo.variables])


def _canopen(nodes: Nodes, tpdos: list[PdoMap], rpdos: list[PdoMap], frames: list[Frame], values: list[Any]) -> Any:
    """The same by canopen: `Network.notify` dispatches, a variable's `raw` decodes and encodes, `transmit` sends."""
    bus = _NoBus()
    network = canopen.Network(bus=bus)
    parts = _parts(nodes)
    remote = [canopen.RemoteNode(part.node.node_id, dictionary_of(part)) for part in parts]
    for node in remote:
        network.add_node(node)
    read, write = [], []
    for part, node in zip(parts, remote, strict=True):
        mine = nodes.pdo_maps(part.name)
        for place, pdo in enumerate([pdo for pdo in tpdos if pdo in mine], 1):
            read += _mapped(node.tpdo[place], pdo, subscribe=True)
    for node, pdo in zip(remote, rpdos, strict=True):
        there = node.rpdo[1]
        write.append((there, _mapped(there, pdo, subscribe=False)))

    def task() -> None:
        for cycle in range(_CYCLES):
            for frame in frames:
                network.notify(frame.can_id, bytearray(frame.data), float(cycle))
            for variable in read:
                _ = variable.raw
            for (pdo, variables), setpoints in zip(write, values, strict=True):
                for variable, value in zip(variables, setpoints, strict=True):
                    variable.raw = value
                pdo.transmit()

    task()
    decoded = [float(variable.raw) for variable in read]
    expected = [float(value) for pdo, frame in zip(tpdos, frames, strict=True) for value in pdo.unpack(frame.data)]
    assert np.allclose(decoded, expected), "canopen and the bench decode the same values"
    bus.shutdown()
    return task


def _mapped(there: Any, pdo: PdoMap, *, subscribe: bool) -> list[Any]:
    there.clear()
    there.cob_id, there.enabled = pdo.cob_id, True
    variables = [there.add_variable(variable.index, variable.subindex) for variable in pdo.variables]
    if subscribe:
        there.subscribe()
    return variables
