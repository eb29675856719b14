"""Sample coherence: check that measured positions of all axes are of one instant, and those of one axis a cycle apart.

On a bus that is late, or loses frames, one axis's position may be of an earlier SYNC than the other's. It is then off
by a cycle's travel, which is many times the web's elongation: 6 mm against 0.3 mm at 3 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilbench.compiled import (
    REAL,
    VECTOR,
    Record,
    Vector,
    compiled,
    entry_point,
    interpreted,
    record_at,
    record_in,
    record_type,
)

#: Largest difference of a travel from what it is to be, as a share of a cycle's travel.
_ALIKE = 0.3
#: The same of rollers that a web couples, for each cycle up to that: those a third of a cycle apart, as a busy machine
#: sends them, let an emulated web jump by 50 N; a drive at its torque limit may leave its web behind by nearly as much.
_COUPLED_ALIKE = 0.15
#: Largest ratio of a cycle's travel to that of the previous one, either way: more is the travel of uncounted cycles,
#: less that of a sample sent twice.
_LONGER = 1.5
#: Share of a new ratio of an axis's travel to that of all, and the travel, in least travels, from which on it has so
#: much weight: an average of twenty cycles, in each of which an encoder is off by less than a thirtieth of this.
_NEW_RATIO, _SHOWS_RATIO = 0.05, 30.0
#: Largest difference of such a ratio from 1: no web bears a draw so large.
_LARGEST_DRAW = 0.1
#: Beyond any acceleration of a line.
_FASTEST_M_S2 = 100.0
#: Further divergence of the axes of one machine allowed per cycle, in those plays.
_APART = 0.5
#: Largest acceleration of a running machine, by the unit of its positions (1/s²).
_RUNNING_PER_S2 = {"m": 20.0, "rad": 2e3}


#: Most successive cycles refused because the axes' travels give different numbers of cycles.
_MOST_REFUSED = 5

#: State of `coherent`, before the positions (N,) that were last coherent, the last ones, and the ratio of each axis's
#: travel to that of all: cycles since the first, and since the second; the travel of a cycle (below 0: unknown);
#: incoherent cycles; whether there are positions.
COHERENCE: Final = record_type("cycles", "since", "travel", "unpaired", "started")
_LAST: Final = COHERENCE.itemsize // 8


def coherence_state(rollers: int) -> Vector:
    """Initial state of `coherent` for so many rollers."""
    state: Vector = np.zeros(_LAST + 3 * rollers)
    state[_LAST + 2 * rollers :] = 1.0
    record_at(state, COHERENCE).travel = -1.0
    return state


@compiled
def _learn_ratios(ratios: Vector, positions: Vector, last: Vector, least_travel: float) -> None:
    """Learn the ratio of each axis's travel to that of all from coherent positions: rollers differ by the draw."""
    total = 0.0
    for k in range(len(positions)):
        total += abs(positions[k] - last[k])
    mean = total / len(positions)
    if mean == 0.0:
        return
    share = _NEW_RATIO * min(mean / (_SHOWS_RATIO * least_travel), 1.0)
    for k in range(len(positions)):
        ratio = ratios[k] + share * (abs(positions[k] - last[k]) / mean - ratios[k])
        ratios[k] = min(max(ratio, 1.0 - _LARGEST_DRAW), 1.0 + _LARGEST_DRAW)


@entry_point(VECTOR, VECTOR, REAL, allocates=False)
def coherent(state: Vector, positions: Vector, least_travel: float) -> bool:
    """True if positions (N,) are of one instant; see `SampleCoherence`."""
    c, n = record_in(state, 0, COHERENCE), len(positions)
    last, previous, ratios = state[_LAST : _LAST + n], state[_LAST + n : _LAST + 2 * n], state[_LAST + 2 * n :]
    c.cycles += 1.0
    c.since += 1.0
    longest, shortest, step, total = -np.inf, np.inf, 0.0, 0.0
    for k in range(n):
        travel = (positions[k] - last[k]) / ratios[k]
        total += positions[k]
        longest, shortest = max(longest, travel), min(shortest, travel)
        step = max(step, abs(positions[k] - previous[k]))
    if not np.isfinite(total):
        c.unpaired += 1.0
        return False
    if c.started != 0.0:
        travel = step / c.since
        if c.travel >= 0.0:
            travel = min(max(travel, c.travel / _LONGER), max(_LONGER * c.travel, least_travel))
        c.travel = travel
    for k in range(n):
        previous[k] = positions[k]
    c.since = 0.0
    if c.started != 0.0:
        if longest - shortest > max(least_travel, min(_COUPLED_ALIKE * c.cycles, _ALIKE) * c.travel):
            c.unpaired += 1.0
            return False
        _learn_ratios(ratios, positions, last, least_travel)
    for k in range(n):
        last[k] = positions[k]
    c.started, c.cycles = 1.0, 0.0
    return True


#: State of `increments_steadily`: allowed change of a cycle's travel, m; the last position and whether there is one;
#: the travel of a cycle and whether it is known; cycles since without a position.
STEADY: Final = record_type("most_m", "last_m", "has_last", "travel_m", "has_travel", "missed")


@compiled
def increments_steadily(state: Record, x_m: float) -> bool:
    """True if Δx fits (1 + missed) cycles at the last speed within the largest acceleration; see `IncrementCheck`."""
    cycles, last_m, before_m = state.missed + 1.0, state.last_m, state.travel_m
    had_last, had_travel = state.has_last != 0.0, state.has_travel != 0.0
    state.last_m, state.has_last, state.missed = x_m, 1.0, 0.0
    if not had_last:
        return True
    state.travel_m, state.has_travel = (x_m - last_m) / cycles, 1.0
    return bool(not had_travel or abs(state.travel_m - before_m) <= state.most_m * cycles + _ALIKE * abs(before_m))


@compiled
def _fits(travels: Vector, usual: Vector, plays: Vector, elapsed: float, fastest: int) -> bool:
    """True if these travels fit so many cycles, at any possible acceleration of a machine, and all axes have gone as
    far as the fastest, whose travel gives the common acceleration: after many cycles one that is a cycle further would
    else pass as accelerated more."""
    turns, spare = usual[fastest] != 0.0, max(_APART * elapsed, 1.0)
    cycles = travels[fastest] / usual[fastest] if turns else 0.0
    fits = True
    for k in range(len(travels)):
        share = _ALIKE * abs(usual[k])
        fits &= abs(travels[k] - elapsed * usual[k]) <= share + elapsed * elapsed * plays[k]
        fits &= not turns or abs(travels[k] - cycles * usual[k]) <= share + spare * plays[k]
    return fits


@entry_point(VECTOR, VECTOR, VECTOR, REAL, allocates=False)
def whole_cycles(travels: Vector, usual: Vector, plays: Vector, reported: float) -> float:
    """Compiled `cycles_elapsed`; -1 where they disagree."""
    fastest = 0
    for k in range(1, len(usual)):
        if abs(usual[k]) > abs(usual[fastest]):
            fastest = k
    by_travel = reported
    if usual[fastest] != 0.0:
        by_travel = max(np.rint(travels[fastest] / usual[fastest]), 0.0)
    is_clear = _ALIKE * abs(usual[fastest]) > plays[fastest]
    if not is_clear and _fits(travels, usual, plays, reported, fastest):
        return reported
    return by_travel if _fits(travels, usual, plays, by_travel, fastest) else -1.0


#: State of `own_travels`: cycles since positions were accepted, and number refused since; cycles between the last two
#: accepted, and those since without positions; whether there are any, and whether the travel of a cycle is known. Then,
#: of each axis, its last position, the travel of a cycle, room for a travel, and its largest change.
OWN: Final = record_type("since", "refused", "elapsed", "behind", "has_positions", "has_usual")
_OF_AXES: Final = OWN.itemsize // 8


def own_travels_state(axes: int, play: float) -> Vector:
    """Initial state of `own_travels` for so many axes."""
    state: Vector = np.zeros(_OF_AXES + 4 * axes)
    state[_OF_AXES + 3 * axes :] = play
    return state


@entry_point(VECTOR, VECTOR, allocates=False)
def own_travels(state: Vector, positions: Vector) -> bool:
    """True if positions (N,) are of one instant; see `OwnIncrements`."""
    own, n = record_in(state, 0, OWN), len(positions)
    own.since += 1.0
    own.behind += 1.0
    last, usual = state[_OF_AXES : _OF_AXES + n], state[_OF_AXES + n : _OF_AXES + 2 * n]
    travels, plays = state[_OF_AXES + 2 * n : _OF_AXES + 3 * n], state[_OF_AXES + 3 * n :]
    if own.has_positions == 0.0:
        own.behind = 0.0
    else:
        for k in range(n):
            travels[k] = positions[k] - last[k]
        elapsed = own.since
        if own.has_usual != 0.0:
            elapsed = whole_cycles(travels, usual, plays, own.since)
        if elapsed < 0.0 and own.refused < _MOST_REFUSED:
            own.refused += 1.0
            return False
        elapsed = own.since if elapsed < 0.0 else elapsed
        # Up to one cycle ahead of the count: a SYNC that was sent late, and the next one on time.
        own.behind = max(own.behind - elapsed, 0.0 if elapsed == 1.0 else -1.0)
        own.elapsed = elapsed
        if elapsed > 0.0:
            for k in range(n):
                usual[k] = travels[k] / elapsed
            own.has_usual = 1.0
    for k in range(n):
        last[k] = positions[k]
    own.has_positions, own.since, own.refused = 1.0, 0.0, 0.0
    return True


def forget_own_travels(state: Vector) -> None:
    """Accept the next positions unchecked."""
    state[:_OF_AXES] = 0.0


_increments_steadily = interpreted(increments_steadily)


class SampleCoherence:
    """Coherence check: compares the travels of all axes since their positions were last of one instant.

    Travels that differ by no more than `least_travel` (m, or rad of a rotary machine) are alike, beside the draw of the
    web, which is learned. Accepted positions are the reference of all later ones: if they were not coherent, none will
    ever be. So after a pause, in which travels grow long, they may differ by no more than before it.
    """

    def __init__(self, least_travel: float) -> None:
        self._least_travel = least_travel
        self._state, self._positions = coherence_state(0), np.zeros(0)

    @property
    def unpaired(self) -> int:
        """Number of incoherent cycles."""
        return int(record_at(self._state, COHERENCE).unpaired)

    def reset(self) -> None:
        """Accept the next positions unchecked."""
        state = record_at(self._state, COHERENCE)
        state.cycles, state.since, state.travel, state.started = 0.0, 0.0, -1.0, 0.0

    def miss(self) -> None:
        """Count a cycle without positions of its own."""
        state = record_at(self._state, COHERENCE)
        state.cycles, state.since = state.cycles + 1.0, state.since + 1.0

    def vectors(self, rollers: int) -> tuple[Vector, Vector]:
        """State of `coherent` for so many rollers, and their positions (N,): for compiled callers."""
        if rollers != len(self._positions):
            self._state, self._positions = coherence_state(rollers), np.zeros(rollers)
        return self._state, self._positions

    def update(self, *positions_m: float) -> bool:
        """True if this cycle's positions of all rollers, in m at the web, are of one instant."""
        self.vectors(len(positions_m))
        self._positions[:] = positions_m
        return coherent(self._state, self._positions, self._least_travel)


class IncrementCheck:
    """Check of a roller's travel against that of the previous cycle and possible acceleration.

    On a bus that is late a position may be that of the previous cycle, or two cycles on: as a speed that would be an
    acceleration impossible for any drive, and a force that no web bears.
    """

    def __init__(self, cycle_s: float) -> None:
        self.vector: Vector = np.zeros(STEADY.itemsize // 8)
        self.state = record_at(self.vector, STEADY)  #: of `increments_steadily`
        self.state.most_m = _FASTEST_M_S2 * cycle_s**2

    def reset(self) -> None:
        """Accept the next position unchecked."""
        self.state.has_last = self.state.has_travel = self.state.missed = 0.0

    def miss(self) -> None:
        """Count a cycle without a position of its own."""
        self.state.missed += 1.0

    def update(self, x_m: float) -> bool:
        """True if this cycle's position, in m at the web, is one cycle after the last, and after those missed since."""
        return _increments_steadily(self.state, x_m)


class OwnIncrements:
    """`SampleCoherence` of axes with independent speeds, by dancers, accumulators and reels: each is compared with its
    own travel per cycle, which must give the same number of cycles for all.

    A lasting disagreement is accepted: a machine may move in unexpected ways.
    """

    def __init__(self, axes: int, of_a_cycle: float) -> None:
        """Create the check; `of_a_cycle`: largest change of a travel, see `play`."""
        self._state, self._positions = own_travels_state(axes, of_a_cycle), np.zeros(axes)

    def vectors(self, axes: int) -> tuple[Vector, Vector]:
        """State of `own_travels` and positions (N,), for compiled callers."""
        return self._state, self._positions

    def reset(self) -> None:
        """Accept the next positions unchecked."""
        forget_own_travels(self._state)

    @property
    def elapsed(self) -> int:
        """Cycles between the last two accepted positions."""
        return int(record_at(self._state, OWN).elapsed)

    @property
    def behind(self) -> int:
        """Cycles since then without positions."""
        return int(record_at(self._state, OWN).behind)

    def miss(self) -> None:
        """Count a cycle without positions of its own."""
        own = record_at(self._state, OWN)
        own.since, own.behind = own.since + 1.0, own.behind + 1.0

    def update(self, *positions: float) -> bool:
        """True if this cycle's positions of all axes, in the machine's unit, are of one instant."""
        self._positions[:] = positions
        return own_travels(self._state, self._positions)


def play(position_unit: str, cycle_s: float) -> float:
    """Largest change of a cycle's travel from one cycle to the next, in the unit of the position ("m" at the web, "rad"
    at a motor)."""
    return _RUNNING_PER_S2[position_unit] * cycle_s**2


def cycles_elapsed(
    travels: Sequence[float], usual: Sequence[float], plays: Sequence[float], reported: int
) -> int | None:
    """Number of cycles by the travel of all axes.

    travels: of each axis since it was last measured; usual: those of one cycle before that; plays: see `play`;
    reported: number of cycles by some clock. Axes that are too slow to show it count as by the clock, unless they can't
    have come so far in that time. None where they disagree, or the travel is none of whole cycles.
    """
    found = whole_cycles(np.array(travels), np.array(usual), np.array(plays), float(reported))
    return None if found < 0.0 else int(found)
