"""Cycle times that the PDO set of a bench fits: on its one wire, and on other bus layouts.

Lockstep needs a wire that is not full. In real time the set points go out in the part of the cycle that the exchange
keeps for them at its end, and the answers come in the rest: each frame, at worst (`hilbench.bench.schedule`). On two
wires, each with a SYNC, every axis is with its load motor and its virtual axis on one of them: a virtual axis still
receives its axis's RPDOs. The twin is on both. With the twin on a wire of its own it receives the other one as well;
its own PDOs are not there. As CAN FD frames the same PDOs are sent at another bit rate from the data
length on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import NamedTuple

from hilbench.bench.schedule import schedule
from hilbench.can.frame import EXTENDED_FLAG
from hilbench.can.load import CyclicFrame, bits_on_wire
from hilbench.can.wire import worst_case_fd_bits
from hilbench.canopen.identifiers import FUNCTION_CODE, HEARTBEAT, SYNC
from hilbench.exchange.nodes import Nodes
from hilbench.topology.config import BenchConfig

BitsOf = Callable[[CyclicFrame], float]
#: Data bit rate of CAN FD that common transceivers are specified for (ISO 11898-2), bit/s.
FD_BITRATE = 5_000_000


@dataclass(frozen=True)
class BusOption:
    """A bus layout: worst-case bit times (of the nominal bit rate) of a cycle on each wire, and the least cycle
    that it fits, s. `usable`: a bench can be run on it."""

    layout: str
    wires: tuple[str, ...]
    bits: tuple[float, ...]
    least_lockstep_s: float
    least_realtime_s: float
    usable: bool = False


class BusOptions(NamedTuple):
    """The one that the bench has, and others. Cycles are whole multiples of the drives' sample time."""

    one_wire: BusOption
    two_wires: BusOption
    twin_apart: BusOption
    can_fd: BusOption


def bus_options(config: BenchConfig, nodes: Nodes) -> BusOptions:
    """Load of the PDO set on each bus layout."""
    frames = nodes.cyclic_frames()
    one = _option(config, f"one wire of {config.bus.bitrate} bit/s", {"one wire": frames})
    return BusOptions(
        replace(one, usable=True),
        _option(config, "two wires", _shared(config, frames)),
        _option(config, "two wires, one of them the twin's", _twin_apart(config, frames)),
        _option(config, f"one wire with CAN FD at {FD_BITRATE} bit/s", {"one wire": frames}, _fd_bits(config)),
    )


def _everywhere(frames: Sequence[CyclicFrame]) -> list[CyclicFrame]:
    return [frame for frame in frames if frame.can_id in (SYNC, HEARTBEAT + 1)]


def _twin_apart(config: BenchConfig, frames: Sequence[CyclicFrame]) -> dict[str, Sequence[CyclicFrame]]:
    """Frames by wire with the virtual nodes' on a wire of their own; a virtual axis only receives its axis's RPDOs."""
    everywhere = _everywhere(frames)
    theirs = [f for f in frames if f not in everywhere and f.can_id & ~FUNCTION_CODE in config.virtual_nodes]
    return {"drives": [frame for frame in frames if frame not in theirs], "twin": [*everywhere, *theirs]}


def _fd_bits(config: BenchConfig) -> BitsOf:
    """Bit times of a frame if it were sent as CAN FD."""

    def bits(frame: CyclicFrame) -> float:
        slow, fast = worst_case_fd_bits(frame.data_bytes, bool(frame.can_id & EXTENDED_FLAG))
        return slow + fast * config.bus.bitrate / FD_BITRATE

    return bits


def _shared(config: BenchConfig, frames: Sequence[CyclicFrame]) -> dict[str, Sequence[CyclicFrame]]:
    """The frames of two wires: axis by axis onto the one that has less."""
    everywhere = _everywhere(frames)
    of_axis: dict[int | None, set[int]] = {}
    with_axis: dict[int, int | None] = {}  # two axes of one node are on one wire
    for part in config.parts:
        node_id = part.node.node_id
        of_axis.setdefault(with_axis.setdefault(node_id, part.axis), set()).add(node_id)
    wires = [list(everywhere), list(everywhere)]
    for node_ids in of_axis.values():
        theirs = [f for f in frames if f not in everywhere and f.can_id & ~FUNCTION_CODE in node_ids]
        min(wires, key=_bits).extend(theirs)
    return {"wire 1": wires[0], "wire 2": wires[1]}


def _bits(frames: Sequence[CyclicFrame], bits_of: BitsOf = bits_on_wire) -> float:
    """Bit times in a cycle, on average."""
    return sum(frame.per_cycle * bits_of(frame) for frame in frames)


def _option(
    config: BenchConfig, layout: str, wires: dict[str, Sequence[CyclicFrame]], bits_of: BitsOf = bits_on_wire
) -> BusOption:
    sample_s, bit_s = config.drive_parameters.sample_time_s, 1.0 / config.bus.bitrate

    def least_s(needed_s: float) -> float:
        return ceil(needed_s / sample_s - 1e-9) * sample_s

    bits = [_bits(frames, bits_of) for frames in wires.values()]
    # Of a cycle of 1 s, the share that is due is the same of any.
    slots = [slot for frames in wires.values() for slot in schedule(frames, 1.0, config.bus.bitrate, bits_of)]
    in_real_time_s = max(slot.ends_s / slot.due_s for slot in slots)
    return BusOption(layout, tuple(wires), tuple(bits), least_s(max(bits) * bit_s), least_s(in_real_time_s))
