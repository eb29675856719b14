"""Whether the measured positions of all axes are of one instant, and those of one axis a cycle apart.

On a bus that is late, or loses frames, one axis' position may be of an earlier SYNC than the other's. It is then off by
the way of a cycle, which is many times what the web is strained by: 6 mm against 0.3 mm at 3 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite

#: Ways of the rollers that differ by more than this share of a cycle's way are not of one instant.
_ALIKE = 0.3
#: A cycle's way is at most so many times that of the cycle before: more was the way of cycles that nobody has counted.
_LONGER = 1.5
#: Beyond any acceleration of a line.
_FASTEST_M_S2 = 100.0
#: How much more the axes of one machine may go apart in a cycle than in the one before, in those plays.
_APART = 0.5
#: What a machine that goes its way is accelerated by at most, by the unit of its positions (1/s²).
_ON_ITS_WAY = {"m": 20.0, "rad": 2e3}


class Pairing:
    """Compares the ways of all axes since their positions were last of one instant.

    Ways that differ by no more than `least_way` (m, or rad of a rotary machine) are alike. What was once taken for
    positions of one instant is what all later ones are compared with: if it was not, none will ever be. So after a
    pause, in which the ways grow long, they may differ by no more than before it.
    """

    def __init__(self, least_way: float) -> None:
        self._least_way = least_way
        self.unpaired = 0  #: cycles whose positions were not of one instant
        self.reset()

    def reset(self) -> None:
        """The next positions are taken as they are."""
        self._last: tuple[float, ...] | None = None
        self._cycles = 0
        self._way: float | None = None  # of a cycle

    def miss(self) -> None:
        """A cycle without positions of its own."""
        self._cycles += 1

    def update(self, *positions_m: float) -> bool:
        """Whether this cycle's positions of all rollers, in m at the web, are of one instant."""
        self._cycles += 1
        last = self._last
        if last is not None:
            ways_m = [abs(now_m - last_m) for now_m, last_m in zip(positions_m, last, strict=True)]
            longest, shortest, least_way = max(ways_m), min(ways_m), self._least_way
            way = longest / self._cycles
            if self._way is not None:
                way = min(way, max(_LONGER * self._way, least_way))
            if not isfinite(sum(ways_m)) or longest - shortest > max(least_way, _ALIKE * way):
                self.unpaired += 1
                return False
            self._way = way
        self._last, self._cycles = positions_m, 0
        return True


class SteadyWay:
    """Whether a roller has come as far as in the cycle before, or as it can have been accelerated since.

    On a bus that is late a position may be that of the cycle before, or two cycles on: as a speed that would be an
    acceleration that no drive has, and a force that no web bears.
    """

    def __init__(self, cycle_s: float) -> None:
        self._most_m = _FASTEST_M_S2 * cycle_s**2
        self.reset()

    def reset(self) -> None:
        """The next positions are taken as they are."""
        self._last_m: float | None = None
        self._way_m: float | None = None  # of a cycle
        self._cycles = 0

    def miss(self) -> None:
        """A cycle without a position of its own."""
        self._cycles += 1

    def update(self, x_m: float) -> bool:
        """Whether this cycle's position, in m at the web, is one cycle after the last, and after those missed since."""
        last_m, before_m, cycles = self._last_m, self._way_m, self._cycles + 1
        self._last_m, self._cycles = x_m, 0
        if last_m is None:
            return True
        self._way_m = (x_m - last_m) / cycles
        return before_m is None or abs(self._way_m - before_m) <= self._most_m * cycles + _ALIKE * abs(before_m)


def play(position_unit: str, cycle_s: float) -> float:
    """By how much the way of a cycle may differ from that of the cycle before, in the unit of the position ("m" at the
    web, "rad" at a motor)."""
    return _ON_ITS_WAY[position_unit] * cycle_s**2


def cycles_gone(ways: Sequence[float], usual: Sequence[float], plays: Sequence[float], told: int) -> int | None:
    """How many cycles all axes have gone on.

    ways: of each axis since it was last measured; usual: those of one cycle before that; plays: see `play`; told: how
    many cycles by some clock. Axes that are too slow to say it have gone as many as the clock says, unless they can't
    have come so far in that time. None where they disagree, or have gone a way that is none of whole cycles.
    """
    fastest = max(range(len(usual)), key=lambda axis: abs(usual[axis]))
    by_way = max(round(ways[fastest] / usual[fastest]), 0) if usual[fastest] else told
    tells = _ALIKE * abs(usual[fastest]) > plays[fastest]
    for gone in (by_way,) if tells else (told, by_way):
        if _fit(ways, usual, plays, gone) and _agree(ways, usual, plays, gone, fastest):
            return gone
    return None


def _fit(ways: Sequence[float], usual: Sequence[float], plays: Sequence[float], gone: int) -> bool:
    """Whether these are ways of so many cycles, at any acceleration of a machine."""
    each = zip(ways, usual, plays, strict=True)
    return all(abs(way - gone * one) <= _ALIKE * abs(one) + gone**2 * play_of for way, one, play_of in each)


def _agree(ways: Sequence[float], usual: Sequence[float], plays: Sequence[float], gone: int, fastest: int) -> bool:
    """Whether all axes have gone as far as the fastest, which tells how all were accelerated: after many cycles one
    that is a cycle further would else pass for one that was accelerated more."""
    if not usual[fastest]:
        return True
    cycles, spare = ways[fastest] / usual[fastest], _APART * gone
    each = zip(ways, usual, plays, strict=True)
    return all(abs(way - cycles * one) <= _ALIKE * abs(one) + max(spare, 1.0) * play_of for way, one, play_of in each)
