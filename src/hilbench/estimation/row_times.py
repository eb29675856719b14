"""Measurement times of a recording's rows, independent of the clock of their time stamps.

The axes answer SYNC, so the rows of a recording are a cycle apart; their time stamps need not be: the recorder's clock
drifts against that of the bus, is set while it runs, and is read late by a different time in each row. Or rows are
missing. Or, without SYNC, the axes were polled at odd times, and the stamps are right. The axes' motion identifies the
case: smooth motion is rough in the wrong time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array

Counts = NDArray[np.int64]

#: Two clocks differ by less than this share: rows this close to whole sample times of the drives count as such.
CLOCKS_DIFFER = 1e-3
#: Distance of a stamp from a period, as a share of it, from which on the stamp alone is not conclusive.
_ODD = 0.5
#: Travel in a period from which on it measures time, m: many steps of an encoder.
_LEAST_TRAVEL_M = 1e-5
#: Rows around a gap whose travel per period counts (median), and stamps that show whether all have moved.
_BESIDE = 3
_AROUND = 10
#: Largest distance of the travel ratio from a whole number for counting periods.
_WHOLE = 0.25
#: Stamps are used row by row where the motion is smoother in them by this factor than in even periods.
_SMOOTHER = 0.5
#: Rows across which the period is measured: jitter of single stamps is shared by so many.
_ACROSS = 500
#: Longest gap between two rows, in periods: a longer one is a new start.
_LONGEST_GAP = 100_000


@dataclass(frozen=True, slots=True)
class RowTimes:
    """Times of n rows on the clock by which they were measured, s since the first."""

    period_s: float  #: between two rows, by the stamps
    times_s: Array  #: (n,), strictly increasing
    periods: Counts  #: (n,) since the first row, where the rows are even
    even: bool  #: rows are whole periods apart; else their stamps are their times


def row_times(stamps_s: Array, positions_m: Array) -> RowTimes:
    """Times of rows from their stamps (n,), strictly increasing, and the axes' positions (n, axes), at the web."""
    steps_s = np.diff(stamps_s)
    nominal_s = float(np.median(steps_s)) if len(steps_s) else 0.0
    if nominal_s <= 0.0:
        return RowTimes(nominal_s, stamps_s - stamps_s[:1], np.arange(len(stamps_s)), even=True)
    travel_m = np.diff(positions_m.mean(axis=1))
    periods = np.concatenate([[0], np.cumsum(_periods_elapsed(stamps_s / nominal_s, travel_m))])
    if _smoother_in_stamps(stamps_s, positions_m.mean(axis=1), np.diff(periods), nominal_s):
        return RowTimes(nominal_s, stamps_s - stamps_s[0], periods, even=False)
    period_s = _period_s(stamps_s, periods)
    return RowTimes(period_s, periods * period_s, periods, even=True)


def _periods_elapsed(stamps: Array, travel_m: Array) -> Counts:
    """Periods between neighbouring rows (n - 1,): one, except at odd stamps (in periods); there by the travel, and at
    rest by the shift of the surrounding stamps: a stamp that was read late has moved alone."""
    steps = np.diff(stamps)
    elapsed = np.ones(len(steps), np.int64)
    for row in np.flatnonzero(np.abs(steps - 1.0) > _ODD):
        beside = (travel_m[max(row - _BESIDE, 0) : row], travel_m[row + 1 : row + 1 + _BESIDE])
        usual_m = float(np.mean([np.median(side) for side in beside if len(side)]))
        by_travel = float(travel_m[row]) / usual_m if abs(usual_m) > _LEAST_TRAVEL_M else 0.0
        whole = round(by_travel)
        # A ramp that bends in the gap has no whole number of travels.
        if whole >= 1 and abs(by_travel - whole) <= _WHOLE * np.sqrt(whole):
            elapsed[row] = whole
        else:
            before, after = stamps[max(row + 1 - _AROUND, 0) : row + 1], stamps[row + 1 : row + 1 + _AROUND]
            moved = np.median(after - np.arange(len(after))) - np.median(before + np.arange(len(before))[::-1])
            elapsed[row] = max(round(float(moved)), 1)
    return np.minimum(elapsed, _LONGEST_GAP)


def _smoother_in_stamps(stamps_s: Array, position_m: Array, elapsed: Counts, nominal_s: float) -> bool:
    """True if the moving axes have a steadier speed by the stamps than by even periods."""
    travel_m, steps = np.diff(position_m), np.diff(stamps_s) / nominal_s
    used = np.abs(travel_m) > _LEAST_TRAVEL_M
    pairs = used[1:] & used[:-1] & (elapsed[1:] == 1) & (elapsed[:-1] == 1)
    if pairs.sum() < _AROUND:
        return False
    rough_m = [float(np.median(np.abs(np.diff(travel_m / parts))[pairs])) for parts in (elapsed, steps)]
    return rough_m[1] < _SMOOTHER * rough_m[0]


def _period_s(stamps_s: Array, periods: Counts) -> float:
    """Period by the stamps' clock: median over ranges of rows, which a clock that is set or jitters hardly moves."""
    across = min(_ACROSS, len(stamps_s) - 1)
    return float(np.median((stamps_s[across:] - stamps_s[:-across]) / (periods[across:] - periods[:-across])))
