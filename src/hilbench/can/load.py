"""Worst-case bus load of a set of cyclic frames, for which the config check refuses a bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hilbench.can.frame import EXTENDED_FLAG
from hilbench.can.wire import worst_case_bits


@dataclass(frozen=True)
class CyclicFrame:
    """A frame that is sent `per_cycle` times in a cycle on average (0.1: in every tenth)."""

    name: str
    can_id: int  #: with the kernel's flag bits
    data_bytes: int
    per_cycle: float = 1.0

    @property
    def worst_case_bits(self) -> float:
        """Bit times per cycle, every possible stuff bit counted."""
        return self.per_cycle * bits_on_wire(self)


def bits_on_wire(frame: CyclicFrame) -> float:
    """Bit times of the frame at worst, each time that it goes out."""
    return worst_case_bits(frame.data_bytes, bool(frame.can_id & EXTENDED_FLAG))


@dataclass(frozen=True)
class BusLoad:
    """Bit times that a cycle needs at worst, and has."""

    bits: float
    capacity_bits: float

    @property
    def fraction(self) -> float:
        """Share of the cycle in which the bus is taken; over 1 it cannot work."""
        return self.bits / self.capacity_bits


def cycle_load(frames: Sequence[CyclicFrame], cycle_s: float, bitrate: int) -> BusLoad:
    """Worst-case load of `frames` in a cycle of `cycle_s` seconds at `bitrate` bit/s.

    Frames that do not go out in every cycle count with their mean: what they displace is made up for in the cycles
    without them. Raises ValueError for a cycle or bit rate that is not positive.
    """
    if not (cycle_s > 0 and bitrate > 0):
        raise ValueError(f"cycle of {cycle_s} s at {bitrate} bit/s: expected both to be positive")
    return BusLoad(sum(frame.worst_case_bits for frame in frames), cycle_s * bitrate)
