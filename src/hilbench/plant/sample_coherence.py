"""Sample coherence: check that measured positions of all axes are of one instant, and those of one axis a cycle apart.

On a bus that is late, or loses frames, one axis's position may be of an earlier SYNC than the other's. It is then off
by a cycle's travel, which is many times the web's elongation: 6 mm against 0.3 mm at 3 m/s.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from hilbench.compiled import (
    REAL,
    VECTOR,
    Record,
    Vector,
    compiled,
    entry_point,
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
#: Shares of a new speed of an axis relative to the others, and of that which is lost in a cycle; noise, as a share of a
#: usual travel; cycles without positions in which all of a speed is lost.
_NEW_SPEED, _LOST_SPEED, _NOISE, _LOST_CYCLES = 0.5, 0.25, 0.25, 100.0
#: Beyond any acceleration of a line.
_FASTEST_M_S2 = 100.0
#: Further divergence of the axes of one machine allowed per cycle, in those plays.
_APART = 0.5
#: Largest acceleration of a running machine, by the unit of its positions (1/s²).
_RUNNING_PER_S2 = {"m": 20.0, "rad": 2e3}


#: Most successive cycles refused because the axes' travels give different numbers of cycles, or change alike.
_MOST_REFUSED = 5
#: Largest change of a travel by a late sample, in travels of a cycle: what is more, as at standstill, is motion.
_MOST_LATE = 20.0

#: State of `coherent`: largest acceleration, in travels of a cycle; cycles since positions were coherent, and since the
#: last ones; the travel of a cycle (below 0: unknown); whether there are positions; cycles in a row with one change of
#: a travel. Mean travel since positions were coherent, and of a cycle before; whether that is known (below 0: nor by
#: the next ones), and whether it may have become this one's. Then `_Travels`.
COHERENCE: Final = record_type(
    *("fastest", "cycles", "since", "travel", "started", "lasting", "gone", "mean", "has_mean", "is_steady")
)
_ROLLERS: Final = COHERENCE.itemsize // 8


class _Travels(NamedTuple):
    """Of each axis (N,): last position; travel of a cycle beyond the mean, and the last change of that; sum of the
    changes since positions were coherent; ratio of its travel to that of all."""

    last: Vector
    beyond: Vector
    changes: Vector
    offsets: Vector
    ratios: Vector


def coherence_state(rollers: int, fastest: float = np.inf) -> Vector:
    """Initial state of `coherent` for so many rollers."""
    state: Vector = np.zeros(_ROLLERS + 5 * rollers)
    state[_ROLLERS + 4 * rollers :] = 1.0
    c = record_at(state, COHERENCE)
    c.fastest, c.travel = fastest, -1.0
    return state


@compiled
def _learn(axes: _Travels, positions: Vector, usual: float, least_travel: float) -> None:
    """Learn the speeds of the axes relative to each other, beyond noise, and the ratio of each axis's travel to that of
    all: rollers differ by the draw."""
    mean, noise = 0.0, _NOISE * usual
    for k in range(len(positions)):
        mean += abs(positions[k] - axes.last[k]) / len(positions)
    share = _NEW_RATIO * min(mean / (_SHOWS_RATIO * least_travel), 1.0)
    for k in range(len(positions)):
        more = axes.changes[k] - min(max(axes.changes[k], -noise), noise)
        axes.beyond[k] += _NEW_SPEED * more
        ratio = axes.ratios[k] + share * (abs(positions[k] - axes.last[k]) / max(mean, 1e-12) - axes.ratios[k])
        axes.ratios[k] = min(max(ratio, 1.0 - _LARGEST_DRAW), 1.0 + _LARGEST_DRAW)


@compiled
def _judge(c: Record, axes: _Travels, positions: Vector, travel: float, least_travel: float) -> bool:
    """True if positions are of the instant that the ones before let expect; `travel`: largest of an axis in a cycle."""
    before, mean, same, count = c.travel, 0.0, True, len(positions)
    if before >= 0.0:
        travel = min(max(travel, before / _LONGER), max(_LONGER * before, least_travel))
    c.travel, usual = travel, max(least_travel, _COUPLED_ALIKE * travel)
    for k in range(count):
        mean += (positions[k] - axes.last[k]) / axes.ratios[k] / count
        same = same and (positions[k] != axes.last[k] or abs(c.mean + axes.beyond[k]) <= least_travel)
    c.gone += mean
    low, high, lower, higher, lost = np.inf, -np.inf, np.inf, -np.inf, _LOST_SPEED * _NOISE * usual
    for k in range(count):
        change = (positions[k] - axes.last[k]) / axes.ratios[k] - mean
        for _ in range(int(min(c.since, _LOST_CYCLES))):
            change -= axes.beyond[k]
            axes.beyond[k] -= min(max(_LOST_SPEED * axes.beyond[k], -lost), lost)
        low, high = min(low, change), max(high, change)
        lower, higher = min(lower, change - axes.changes[k]), max(higher, change - axes.changes[k])
        axes.changes[k] = change
    same = same and higher - lower <= usual < high - low
    is_motion = before >= 0.0 and high - low > max(usual, _MOST_LATE * before)
    low, high = np.inf, -np.inf
    for k in range(count):
        axes.offsets[k] += 0.0 if is_motion else axes.changes[k]
        low, high = min(low, axes.offsets[k]), max(high, axes.offsets[k])
    alike = high - low <= max(least_travel, min(_COUPLED_ALIKE * c.cycles, _ALIKE) * travel)
    c.lasting = 0.0 if alike else c.lasting + 1.0 if same else 1.0
    if is_motion or c.lasting >= _MOST_REFUSED:  # no late sample makes these changes, but another speed of an axis
        for k in range(count):
            axes.beyond[k] += axes.changes[k] / c.since
            axes.offsets[k] -= 0.0 if is_motion else c.lasting * axes.changes[k]
            axes.changes[k] = 0.0
        c.lasting = 0.0
    if alike and c.cycles == 1.0:  # others may have made up for a late one
        _learn(axes, positions, usual, least_travel)
    return bool(alike)


@entry_point(VECTOR, VECTOR, REAL, allocates=False)
def coherent(state: Vector, positions: Vector, least_travel: float) -> bool:
    """True if positions (N,) are of one instant; see `SampleCoherence`."""
    c, n, alike, travel, total = record_in(state, 0, COHERENCE), len(positions), True, 0.0, 0.0
    of = state[_ROLLERS:]
    axes = _Travels(of[:n], of[n : 2 * n], of[2 * n : 3 * n], of[3 * n : 4 * n], of[4 * n :])
    c.cycles += 1.0
    c.since += 1.0
    for k in range(n):
        total += positions[k]
        travel = max(travel, abs(positions[k] - axes.last[k]) / c.since)
    if not np.isfinite(total):
        return False
    if c.started != 0.0:
        alike = _judge(c, axes, positions, travel if travel > 0.0 else max(c.travel, 0.0), least_travel)
    for k in range(n):
        axes.last[k] = positions[k]
    c.since = 0.0
    if not alike:
        return False
    mean, room = c.gone / c.cycles, c.fastest * c.cycles + _ALIKE * abs(c.mean)
    c.is_steady = 1.0 if c.has_mean <= 0.0 or abs(mean - c.mean) <= room else 0.0
    c.mean, c.has_mean, c.started, c.gone, c.cycles = mean, min(c.has_mean + c.started, 1.0), 1.0, 0.0, 0.0
    axes.offsets[:] = 0.0
    return True


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


class SampleCoherence:
    """Coherence check: compares the travels of all axes from cycle to cycle (of `cycle_s`, for `is_steady` alone).

    Travels may differ by as much as before and `least_travel` (m, or rad of a rotary machine), beside the draw of the
    web, which is learned. What differs more is of another instant, and positions are coherent again when later samples
    have made up for it. Axes may move relative to each other: at the start of a soft web, or when one is at its limit.
    """

    def __init__(self, least_travel: float, cycle_s: float = np.inf) -> None:
        self._least_travel, self._fastest = least_travel, _FASTEST_M_S2 * cycle_s**2
        self._state, self._positions = coherence_state(0), np.zeros(0)

    def reset(self) -> None:
        """Accept the next positions unchecked."""
        self._state[:] = coherence_state(len(self._positions), self._fastest)

    def forget_speed(self) -> None:
        """Let the next travel be any: that of the positions after the next ones."""
        record_at(self._state, COHERENCE).has_mean = -1.0

    def miss(self) -> None:
        """Count a cycle without positions of its own."""
        state = record_at(self._state, COHERENCE)
        state.cycles, state.since = state.cycles + 1.0, state.since + 1.0

    def vectors(self, rollers: int) -> tuple[Vector, Vector]:
        """State of `coherent` for so many rollers, and their positions (N,): for compiled callers."""
        if rollers != len(self._positions):
            self._state, self._positions = coherence_state(rollers, self._fastest), np.zeros(rollers)
        return self._state, self._positions

    def update(self, *positions_m: float) -> bool:
        """True if this cycle's positions of all rollers, in m at the web, are of one instant."""
        self.vectors(len(positions_m))
        self._positions[:] = positions_m
        return coherent(self._state, self._positions, self._least_travel)


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
