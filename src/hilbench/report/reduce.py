"""Makes long signals small enough for a picture without losing what the eye would see."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def moving_average(values: ArrayLike, samples: int) -> Array:
    """Centred mean over `samples` (made odd); at the ends over the samples that are there. NaN stays local."""
    data = np.asarray(values, np.float64)
    half = min(samples // 2, max(len(data) - 1, 0) // 2)
    known = np.isfinite(data)
    total = np.concatenate(([0.0], np.cumsum(np.where(known, data, 0.0))))
    count = np.concatenate(([0], np.cumsum(known)))
    start = np.clip(np.arange(len(data)) - half, 0, None)
    stop = np.clip(np.arange(len(data)) + half + 1, None, len(data))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((total[stop] - total[start]) / (count[stop] - count[start]), np.float64)


def mean_velocity(t_s: ArrayLike, x_m: ArrayLike, samples: int) -> Array:
    """Velocity (m/s) as a triangular moving average over `samples`, from the position: no differentiation noise.

    The change of position over half of them is the plain average over that half; the average of it over the other
    half also takes out the steps of the encoder.
    """
    time_s, position_m = np.asarray(t_s, np.float64), np.asarray(x_m, np.float64)
    half = min(max(samples // 4, 1), max(len(time_s) - 1, 1))
    start = np.clip(np.arange(len(time_s)) - half, 0, None)
    stop = np.clip(np.arange(len(time_s)) + half, None, len(time_s) - 1)
    return moving_average((position_m[stop] - position_m[start]) / (time_s[stop] - time_s[start]), samples // 2)


def envelope(t_s: ArrayLike, values: ArrayLike, columns: int) -> tuple[Array, Array, Array]:
    """Least and largest value in each of `columns` stretches of equal sample count: time, lower, upper.

    Fewer samples than columns come back as they are (lower and upper equal). A stretch without a number is NaN.
    """
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    if len(data) <= columns:
        return time_s, data, data
    edges = np.linspace(0, len(data), columns + 1).astype(int)
    lower = np.minimum.reduceat(np.where(np.isnan(data), np.inf, data), edges[:-1])
    upper = np.maximum.reduceat(np.where(np.isnan(data), -np.inf, data), edges[:-1])
    empty = lower > upper
    lower[empty], upper[empty] = np.nan, np.nan
    centres = (time_s[edges[:-1]] + time_s[edges[1:] - 1]) / 2
    return centres, lower, upper


def thinned(t_s: ArrayLike, values: ArrayLike, columns: int) -> tuple[Array, Array]:
    """The signal as a line through each stretch's least and largest value, in the order they came."""
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    if len(data) <= 2 * columns:
        return time_s, data
    edges = np.linspace(0, len(data), columns + 1).astype(int)
    keep: list[int] = []
    for start, stop in pairwise(edges.tolist()):
        part = data[start:stop]
        known = np.flatnonzero(np.isfinite(part))
        if not len(known):
            keep.append(int(start))
            continue
        low, high = known[np.argmin(part[known])], known[np.argmax(part[known])]
        keep.extend(sorted({int(start + low), int(start + high)}))
    return time_s[keep], data[keep]
