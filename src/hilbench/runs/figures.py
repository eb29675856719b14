"""Figures of recorded signals, by themselves: pure functions on one-dimensional arrays over one time base `t_s` (s,
strictly increasing).

The *settled part* of a signal is the end of a segment, without what is left of the transient (`settled_part`).
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from hilbench.arrays import Array
from hilbench.runs.events import STEP_SHARE

#: Share of the working speed by which the command may differ from it inside the window.
SPEED_BAND: Final = 1e-3
#: Longest settled part, s, and the least that still counts as one.
SETTLED_S: Final = 5.0
LEAST_SETTLED_S: Final = 1.0
#: Half width of the band that an estimate has to enter, as a share of the true value.
ESTIMATE_BAND: Final = 0.01
#: What is left of a transient makes the first third of a signal so many times as uneven as its last; it is looked for
#: where so large a share of what may be cut off was.
_STILL_SETTLING: Final = 3.0
_AT_THE_LIMIT: Final = 0.9


def working_window(t_s: ArrayLike, command: ArrayLike) -> slice | None:
    """Samples of the longest segment (in time) in which the command of the speed is the run's largest, within 0.1 %.

    None if the machine never ran.
    """
    time_s, size = np.asarray(t_s, np.float64), np.abs(np.asarray(command, np.float64))
    finite = np.isfinite(size)
    top = np.max(size[finite], initial=0.0)
    if top == 0:
        return None
    inside = finite & (np.where(finite, size, 0) >= top * (1 - SPEED_BAND))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(np.int8), [0]))))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(time_s[ends - 1] - time_s[starts]))
    return slice(int(starts[longest]), int(ends[longest]))


def last_step(true_value: ArrayLike) -> int | None:
    """Index of the first sample with the value after the last step of the true value; None if it never stepped.

    A ramp over some samples, each above `STEP_SHARE`, counts as one step that ends with it.
    """
    true = np.asarray(true_value, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.flatnonzero(np.abs(true[1:] / true[:-1] - 1) > STEP_SHARE)
    return int(steps[-1]) + 1 if len(steps) else None


def settled_part(t_s: ArrayLike, values: ArrayLike) -> slice:
    """The end of a segment without its transient: at most the last `SETTLED_S`, at least the last `LEAST_SETTLED_S`.

    Where the transient ends is decided by the marginal standard error rule: cut off is what makes the standard error
    of the mean of the rest least, up to half of the segment (White, An effective truncation heuristic for bias
    reduction in simulation output, Simulation 69(6), 1997).
    """
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    earliest = int(np.searchsorted(time_s, time_s[-1] - SETTLED_S))
    return slice(max(_truncation(data, _latest_cut(time_s)), earliest), None)


def _latest_cut(time_s: Array) -> int:
    return min(int(np.searchsorted(time_s, time_s[-1] - LEAST_SETTLED_S)), len(time_s) // 2)


def _truncation(data: Array, latest: int) -> int:
    """Number of samples to leave out at the start, at most `latest`, for the least standard error of the mean."""
    backwards = (data - data[-1])[::-1]
    count = np.arange(1, len(data) + 1)
    squares = np.cumsum(backwards**2) - np.cumsum(backwards) ** 2 / count
    errors = (np.maximum(squares, 0.0) / count**2)[::-1]
    return int(np.argmin(errors[: latest + 1]))


def still_settling(t_s: ArrayLike, values: ArrayLike) -> bool:
    """True if the settled part of a short segment still has some of the transient: as much was cut off as may be,
    and the first third of the rest is far more uneven about its straight-line trend than the last."""
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    latest, part = _latest_cut(time_s), settled_part(time_s, data)
    third = len(data[part]) // 3
    if third < 2 or part.start > latest or _truncation(data, latest) < _AT_THE_LIMIT * latest:
        return False
    first = _rms(_about_trend(time_s[part], data[part])[:third])
    last = _rms(_about_trend(time_s[-third:], data[-third:]))
    return first > _STILL_SETTLING * last + 1e-9 * float(np.max(np.abs(data)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def least_stay_s(hold_s: float) -> float:
    """Time (s) that a signal must have been in its band at the end of a hold to count as settled."""
    return min(LEAST_SETTLED_S, hold_s / 4)


def time_to_stay(t_s: ArrayLike, error: ArrayLike, band: float, start: int) -> float | None:
    """Time (s) from sample `start` until ``|error| <= band`` holds for every later sample.

    None if it does not hold in the end, or for less than `least_stay_s`. A sample that is no number is outside.
    """
    time_s, values = np.asarray(t_s, np.float64)[start:], np.asarray(error, np.float64)[start:]
    entered = stays_from(values, band)
    if entered == len(time_s) or time_s[-1] - time_s[entered] < least_stay_s(float(time_s[-1] - time_s[0])):
        return None
    return float(time_s[entered] - time_s[0])


def stays_from(error: Array, band: float) -> int:
    """The first sample from which on all are in the band; the length if the last one is not."""
    outside = np.flatnonzero(~(np.abs(error) <= band))
    return int(outside[-1]) + 1 if len(outside) else 0


def overshoot_pct(estimate: ArrayLike, true_value: ArrayLike, step: int) -> float | None:
    """Largest excess of the estimate beyond the true value, in the step's direction, as % of the step; noise included.

    The step is the difference between the true value at `step` and before the ramp of samples that led to it.
    """
    estimate, true = np.asarray(estimate, np.float64), np.asarray(true_value, np.float64)
    before = step - 1
    while before > 0 and abs(true[before] / true[before - 1] - 1) > STEP_SHARE:
        before -= 1
    height = true[step] - true[before]
    excess = 100 * np.max((estimate[step:] - true[step:]) / height)
    return None if np.isnan(excess) else max(0.0, float(excess))


def noise_pct(t_s: ArrayLike, estimate: ArrayLike, true_value: ArrayLike) -> float | None:
    """Rms of the estimate about its least-squares straight line over time, as % of the mean true value."""
    rms = trend_rms(np.asarray(t_s, np.float64), np.asarray(estimate, np.float64))
    return finite_or_none(100 * rms / float(np.mean(np.asarray(true_value, np.float64))))


def trend_rms(time_s: Array, values: Array) -> float:
    """Rms of values about their least-squares straight line over time."""
    return float(np.std(_about_trend(time_s, values)))


def _about_trend(time_s: Array, values: Array) -> Array:
    """Residual of values about their least-squares straight line over time."""
    centred_s, centred = time_s - time_s.mean(), values - values.mean()
    spread = float(centred_s @ centred_s)
    slope = float(centred_s @ centred) / spread if spread else 0.0
    return np.asarray(centred - slope * centred_s, np.float64)


def mean_velocity(t_s: ArrayLike, position: ArrayLike) -> float:
    """Velocity as the least-squares slope of the encoder's position: far finer than the differentiated velocity."""
    time_s, values = np.asarray(t_s, np.float64), np.asarray(position, np.float64)
    centred_s = time_s - time_s.mean()
    return float(centred_s @ (values - values.mean()) / (centred_s @ centred_s))


def finite_or_none(value: float | np.floating[Any] | None) -> float | None:
    """The value as a number; None for what is none."""
    return float(value) if value is not None and np.isfinite(value) else None
