"""Which cycles the PDO set of a bench fits: on its one wire, and what it would be on two.

Lockstep needs a wire that is not full. In real time the set points go out in the part of the cycle that the exchange
keeps for them at its end, and the answers come in the rest. On two wires, each with a SYNC, every axis is with its load
motor and its virtual axis on one of them: a virtual axis still hears what its axis is told. The twin is on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from hilbench.can.load import CyclicFrame
from hilbench.canopen.identifiers import FUNCTION_CODE, HEARTBEAT, RPDOS, SYNC
from hilbench.exchange.nodes import Nodes
from hilbench.exchange.sync_cycle import GUARD_FRACTION
from hilbench.topology.config import BenchConfig


@dataclass(frozen=True)
class BusOption:
    """One way to lay the wires: bit times of a cycle at worst on each, and the least cycle that it fits, s."""

    wires: tuple[str, ...]
    bits: tuple[float, ...]
    least_lockstep_s: float
    least_realtime_s: float


def bus_options(config: BenchConfig, nodes: Nodes) -> tuple[BusOption, BusOption]:
    """On one wire, and on two. Cycles are whole multiples of the drives' sample time."""
    frames = nodes.cyclic_frames()
    return _option(config, {"one wire": frames}), _option(config, _shared(config, frames))


def _shared(config: BenchConfig, frames: Sequence[CyclicFrame]) -> dict[str, Sequence[CyclicFrame]]:
    """The frames of two wires: axis by axis onto the one that has less."""
    everywhere = [frame for frame in frames if frame.can_id in (SYNC, HEARTBEAT + 1)]
    of_axis: dict[int | None, set[int]] = {}
    for part in config.parts:
        of_axis.setdefault(part.axis, set()).add(part.node.node_id)
    wires = [list(everywhere), list(everywhere)]
    for node_ids in of_axis.values():
        theirs = [f for f in frames if f not in everywhere and f.can_id & ~FUNCTION_CODE in node_ids]
        min(wires, key=_bits).extend(theirs)
    return {"wire 1": wires[0], "wire 2": wires[1]}


def _bits(frames: Sequence[CyclicFrame]) -> float:
    return sum(frame.worst_case_bits for frame in frames)


def _option(config: BenchConfig, wires: dict[str, Sequence[CyclicFrame]]) -> BusOption:
    sample_s, bit_s = config.drive_parameters.sample_time_s, 1.0 / config.bus.bitrate

    def least_s(needed_s: float) -> float:
        return ceil(needed_s / sample_s - 1e-9) * sample_s

    bits, in_real_time = [], []
    for frames in wires.values():
        total = _bits(frames)
        told = _bits([frame for frame in frames if frame.can_id & FUNCTION_CODE in RPDOS])
        bits.append(total)
        in_real_time.append(max(told / GUARD_FRACTION, (total - told) / (1.0 - GUARD_FRACTION)))
    return BusOption(tuple(wires), tuple(bits), least_s(max(bits) * bit_s), least_s(max(in_real_time) * bit_s))
