"""Makes long signals small enough for a picture without losing what the eye would see."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.arrays import Array

#: A window at an event is that part of the others.
_NARROWEST = 10


def moving_average(values: ArrayLike, samples: int, breaks: Sequence[int] = ()) -> Array:
    """Centred mean over `samples` (made odd); at the ends over the samples that are there. NaN stays local.

    No mean reaches over one of the `breaks` (indices of the first sample after an event): what an event does is not
    seen before it. It is the narrower the nearer the event is, on both sides alike, so that a ramp stays a ramp.
    """
    data = np.asarray(values, np.float64)
    return _by_part(breaks, lambda ends, part: _centred_mean(part, samples, ends), data)


def mean_velocity(t_s: ArrayLike, x_m: ArrayLike, samples: int, breaks: Sequence[int] = ()) -> Array:
    """Velocity (m/s) as a triangular moving average over `samples`, from the position: no differentiation noise.

    The change of position over half of them is the plain average over that half; the average of it over the other
    half also takes out the steps of the encoder. `breaks` as in `moving_average`.
    """
    time_s, position_m = np.asarray(t_s, np.float64), np.asarray(x_m, np.float64)
    return _by_part(breaks, lambda ends, t, x: _mean_slope(t, x, samples, ends), time_s, position_m)


#: Whether a stretch begins and ends with an event.
_Ends = tuple[bool, bool]


def _by_part(breaks: Sequence[int], mean: Callable[..., Array], *signals: Array) -> Array:
    """A mean of the stretches between the breaks, one by one."""
    count = len(signals[0])
    bounds = [0, *sorted({at for at in breaks if 0 < at < count}), count]
    means = [
        mean((start > 0, stop < count), *(signal[start:stop] for signal in signals)) for start, stop in pairwise(bounds)
    ]
    return np.concatenate(means) if count else signals[0]


def _centred_mean(data: Array, samples: int, ends: _Ends) -> Array:
    half = min(samples // 2, max(len(data) - 1, 0) // 2)
    known = np.isfinite(data)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, data, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    start, last = _windows(len(data), half, ends)
    stop = last + 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[stop] - total[start]) / (count[stop] - count[start]), np.float64)


def _mean_slope(time_s: Array, position_m: Array, samples: int, ends: _Ends) -> Array:
    start, stop = _windows(len(time_s), min(max(samples // 4, 1), max(len(time_s) - 1, 1)), ends)
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = (position_m[stop] - position_m[start]) / (time_s[stop] - time_s[start])
    return _centred_mean(slope, samples // 2, ends)


def _windows(count: int, half: int, ends: _Ends) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """First and last sample of the window about each sample: `half` to both sides, and near an event only as far as
    that is, but never so narrow that a mean would be of single samples."""
    at = np.arange(count)
    room = np.full(count, half)
    for near, distance in zip(ends, (at, count - 1 - at), strict=True):
        if near:
            room = np.minimum(room, distance)
    room = np.maximum(room, min(half, max(half // _NARROWEST, 1)))
    return np.clip(at - room, 0, None), np.clip(at + room, None, count - 1)


def envelope(t_s: ArrayLike, values: ArrayLike, columns: int) -> tuple[Array, Array, Array]:
    """Least and largest value in each of `columns` stretches of equal sample count: time, lower, upper.

    Fewer samples than columns come back as they are (lower and upper equal). A stretch without a number is NaN.
    """
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    if len(data) <= columns:
        return time_s, data, data
    edges = np.linspace(0, len(data), columns + 1).astype(int)
    lower, upper = (extreme.reduceat(data, edges[:-1]) for extreme in (np.fmin, np.fmax))
    centres = (time_s[edges[:-1]] + time_s[edges[1:] - 1]) / 2
    return centres, lower, upper


def thinned(t_s: ArrayLike, values: ArrayLike, columns: int) -> tuple[Array, Array]:
    """The signal as a line through each stretch's least and largest value, in the order they came."""
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    if len(data) <= 2 * columns:
        return time_s, data
    keep = np.unique(_extremes(data, np.linspace(0, len(data), columns + 1).astype(int)))
    return time_s[keep], data[keep]


def stretches(t_s: ArrayLike, fine: Iterable[tuple[float, float]], points: int) -> NDArray[np.int_]:
    """Edges (indices) of the stretches that a signal is reduced to with about `points` points, two a stretch.

    Within the intervals `fine` (s) every sample is a stretch, as long as that takes no more than half of the points;
    no stretch reaches over one of their ends. The last edge is the number of samples.
    """
    time_s = np.asarray(t_s, np.float64)
    count = len(time_s)
    if count <= points:
        return np.arange(count + 1)
    limits = [np.searchsorted(time_s, ends) for ends in fine]
    inside = np.zeros(count, bool)
    for start, stop in limits:
        inside[start:stop] = True
    within = int(np.count_nonzero(inside))
    share = _samples_a_stretch(within, points // 2)
    used = within if share == 1 else points // 2
    coarse = _samples_a_stretch(count - within, points - used)
    edges = [0, count, *(int(start) for start, _ in limits), *(int(stop) for _, stop in limits)]
    bounds = sorted({edge for edge in edges if 0 <= edge <= count})
    pieces = [np.arange(a, b, share if inside[a] else coarse) for a, b in pairwise(bounds)]
    return np.concatenate([*pieces, [count]]).astype(int)


def _samples_a_stretch(samples: int, points: int) -> int:
    """One, where there is a point for each sample; as many that two points a stretch are enough otherwise."""
    return 1 if samples <= points else int(np.ceil(2 * samples / max(points, 1)))


def reduced_times(t_s: ArrayLike, edges: NDArray[np.int_]) -> Array:
    """Times of the points of `reduced`: a stretch of one sample has one, a longer one two."""
    time_s = np.asarray(t_s, np.float64)
    first, middle = edges[:-1], (edges[:-1] + edges[1:]) // 2
    return np.asarray(_interleaved(time_s[first], time_s[middle], np.diff(edges) > 1), np.float64)


def reduced(values: ArrayLike, edges: NDArray[np.int_]) -> Array:
    """A signal by the least and the largest value of each stretch, in the order in which they came: no spike is lost.

    A stretch without a number is NaN.
    """
    data = np.asarray(values, np.float64)
    starts, long = edges[:-1], np.diff(edges) > 1
    if not len(starts):
        return data[:0]
    first, second = _extremes(data, edges)
    known = np.where(np.isfinite(data), data, np.nan)
    return _interleaved(known[first], known[second], long)


def _extremes(data: Array, edges: NDArray[np.int_]) -> NDArray[np.int_]:
    """Places of the least and the largest value of each stretch, in the order in which they came, (2, stretches); its
    start twice where it has no number."""
    starts, owner = edges[:-1], np.repeat(np.arange(len(edges) - 1), np.diff(edges))
    known, places = np.isfinite(data), np.arange(len(data))
    found = []
    for extreme, beyond in ((np.minimum, np.inf), (np.maximum, -np.inf)):
        values = np.where(known, data, beyond)
        is_extreme = values == extreme.reduceat(values, starts)[owner]
        found.append(np.minimum.reduceat(np.where(is_extreme, places, len(data)), starts))
    return np.sort(found, axis=0)


def _interleaved(first: Array, second: Array, both: NDArray[np.bool_]) -> Array:
    """The first of each pair, and the second where both are wanted."""
    wanted = np.column_stack([np.ones(len(first), bool), both]).ravel()
    return np.asarray(np.column_stack([first, second]).ravel()[wanted], np.float64)
