"""Error injection: disturbances of a frame on the emulated wire, drawn from a seed.

The draws for the n-th frame of an identifier depend on seed, identifier and n alone, not on how the senders'
frames interleave: two lockstep runs with one seed disturb the same frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from hilbench.can.confinement import OFF_FROM
from hilbench.can.frame import accepts

#: So many failed attempts in a row take any transmitter off the bus (`confinement`): no frame needs a draw for more.
MAX_ATTEMPTS = OFF_FROM // 8
_COUNTED_IDENTIFIERS = 4096
_MASK_64 = (1 << 64) - 1


@dataclass(frozen=True)
class ErrorInjection:
    """Probabilities (0 to 1, per frame; `corrupted` per attempt) of disturbances of frames on the wire.

    lost: takes its time on the wire and is not received. corrupted: broken off by an error frame at a random bit and
    sent again, after a new arbitration; a station with too many of these goes bus off (`confinement`). duplicated: sent
    twice. delayed: the sender's controller holds it, and those queued after it, for `delay_s` seconds of bus time.
    `filters` restricts it to identifiers, as (identifier, mask) pairs.
    """

    seed: int = 0
    lost: float = 0.0
    corrupted: float = 0.0
    duplicated: float = 0.0
    delayed: float = 0.0
    delay_s: float = 0.0
    filters: tuple[tuple[int, int], ...] | None = None

    def __post_init__(self) -> None:
        for name in ("lost", "corrupted", "duplicated", "delayed"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name}: found {getattr(self, name)}, expected a probability from 0 to 1")
        if not 0.0 <= self.delay_s <= 60.0:
            raise ValueError(f"delay_s: found {self.delay_s}, expected 0 to 60 seconds")


class FrameOutcome(NamedTuple):
    """Outcome drawn for one frame."""

    lost: bool
    duplicated: bool
    delay_ns: int
    #: Bits each failed attempt lasts until the error frame begins.
    broken_off_after: tuple[int, ...]


def _uniform(key: int) -> Iterator[float]:
    """Independent numbers in [0, 1) for a 64-bit key: splitmix64 (Steele, Lea, Flood 2014)."""
    state = key & _MASK_64
    while True:
        state = state + 0x9E3779B97F4A7C15 & _MASK_64
        mixed = (state ^ state >> 30) * 0xBF58476D1CE4E5B9 & _MASK_64
        mixed = (mixed ^ mixed >> 27) * 0x94D049BB133111EB & _MASK_64
        yield ((mixed ^ mixed >> 31) >> 11) * 2.0**-53


def _key(seed: int, can_id: int, count: int) -> int:
    """64-bit key that is distinct for every (seed, identifier, count)."""
    key = 0
    for part in (seed, can_id, count):
        key = int(next(_uniform(key ^ part)) * 2.0**53)
    return key


class Disturber:
    """Draws the fate of frame after frame of one bus."""

    def __init__(self, injection: ErrorInjection) -> None:
        self._injection = injection
        self._counts: dict[int, int] = {}

    def draw(self, can_id: int, bits: int) -> FrameOutcome | None:
        """FrameOutcome of the next frame of `can_id`, which lasts `bits` bit times; None: nothing happens to it."""
        injection = self._injection
        if not accepts(injection.filters, can_id):
            return None
        # Beyond so many identifiers the new ones share a count: memory stays bounded.
        counted = can_id if can_id in self._counts or len(self._counts) < _COUNTED_IDENTIFIERS else -1
        count = self._counts[counted] = self._counts.get(counted, 0) + 1
        numbers = _uniform(_key(injection.seed, can_id, count))
        lost = next(numbers) < injection.lost
        duplicated = next(numbers) < injection.duplicated
        delay_ns = round(injection.delay_s * 1e9) if next(numbers) < injection.delayed else 0
        broken_off: list[int] = []
        while len(broken_off) < MAX_ATTEMPTS and next(numbers) < injection.corrupted:
            broken_off.append(1 + int(next(numbers) * (bits - 4)))  # somewhere before the intermission
        if not (lost or duplicated or delay_ns or broken_off):
            return None
        return FrameOutcome(lost, duplicated, delay_ns, tuple(broken_off))
