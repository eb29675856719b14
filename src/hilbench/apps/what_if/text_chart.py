"""A course with its band as text, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MEDIAN: Final = "━"
_BAND: Final = "░"
_LEVEL: Final = "┄"
#: A course that moves less than this share of its size, or this much, is drawn as flat.
_FLAT_SHARE: Final = 0.02
_FLAT: Final = 1e-3


def text_chart(
    times_s: Array,
    band: tuple[Array, Array, Array],
    levels: Sequence[float] = (),
    *,
    width: int = 64,
    height: int = 8,
) -> list[str]:
    """Lines of a chart: low, median and high (n,) of a course over `times_s` (n,), and those of the `levels` (of its
    size) that are not too far from it to be in the picture; the axis of time below."""
    low, median, high = (_columns(values, width) for values in band)
    bottom, top = _extent(low, high, levels)
    rows = [[" "] * len(median) for _ in range(height)]

    def row(value: float) -> int:
        return height - 1 - round((value - bottom) / (top - bottom) * (height - 1))

    for level in (sign * level for level in levels for sign in (1.0, -1.0)):
        if bottom <= level <= top:
            rows[row(level)] = [_LEVEL] * len(median)
    for column, (least, middle, most) in enumerate(zip(low, median, high, strict=True)):
        for at in range(row(most), row(least) + 1):
            rows[at][column] = _BAND
        rows[row(middle)][column] = _MEDIAN
    labels = {0: f"{top:.4g}", height - 1: f"{bottom:.4g}"}
    lines = [f"{labels.get(number, ''):>9} │{''.join(cells)}" for number, cells in enumerate(rows)]
    ends = f"{times_s[0]:.1f} s", f"{times_s[-1]:.1f} s"
    return [*lines, f"{'':>9} └{'─' * len(median)}", f"{'':>11}{ends[0]}{ends[1]:>{len(median) - len(ends[0])}}"]


def _columns(values: Array, width: int) -> Array:
    at = np.linspace(0, len(values) - 1, min(width, len(values))).round().astype(int)
    return np.asarray(values[at], np.float64)


def _extent(low: Array, high: Array, levels: Sequence[float]) -> tuple[float, float]:
    bottom, top = float(low.min()), float(high.max())
    least = max(_FLAT, _FLAT_SHARE * max(abs(bottom), abs(top)))
    if top - bottom < least:
        middle = 0.5 * (top + bottom)
        bottom, top = middle - 0.5 * least, middle + 0.5 * least
    for level in levels:  # one that is near is part of the picture
        if top < level < top + (top - bottom):
            top = level
        if bottom - (top - bottom) < -level < bottom:
            bottom = -level
    return bottom, top
