"""The page of a look ahead: tensions and torques to come, with bands and limits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from hilbench.apps.report.chart import BLUE, VERMILLION, Band, Chart, Curve
from hilbench.apps.report.page import quantity, write_page
from hilbench.apps.report.plots import Picture, drawn
from hilbench.arrays import Array
from hilbench.prediction.outlook import Outlook, WatchedQuantity
from hilbench.results.what_if import Answer

_MEDIAN: Final = "━"
_BAND: Final = "░"
_LEVEL: Final = "┄"
#: A course that moves less than this share of its size, or this much, is drawn as flat.
_FLAT_SHARE: Final = 0.02
_FLAT: Final = 1e-3
Summary = tuple[WatchedQuantity, list[float], list[float], float]


def text_chart(
    times_s: Array, band: tuple[Array, Array, Array], levels: Sequence[float] = (), *, width: int = 64, height: int = 8
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


def rows_of(outlook: Outlook) -> list[Summary]:
    """Rows of each quantity: median, low and high (90 % of the futures) of its largest size, and of its value at the
    end; the probability of the lowest level that it has."""
    found: list[Summary] = []
    for place, watched in enumerate(outlook.watched):
        largest = np.quantile(outlook.largest[:, place], (0.5, 0.05, 0.95)).tolist()
        end = np.quantile(outlook.rows[-1, :, place], (0.5, 0.05, 0.95)).tolist()
        column = 0 if watched.warning is not None else 1
        found.append((watched, largest, end, float(outlook.probability[place, column])))
    return found


def levels_of(watched: WatchedQuantity) -> list[float]:
    """Its limits."""
    return [level for level in (watched.warning, watched.trip) if level is not None]


def write_what_if_page(answer: Answer, asked: Sequence[str], name: str, path: Path) -> Path:
    """Write the page; returns its path. Raises UnusableInputError if it cannot be."""
    pictures = [_picture(answer.outlook, place) for place in range(len(answer.outlook.watched))]
    rows = [
        (
            watched.name,
            quantity(largest[0], watched.unit),
            f"{quantity(largest[1], watched.unit)} … {quantity(largest[2], watched.unit)}",
            quantity(end[0], watched.unit),
            watched.unit,
            " / ".join(f"{level:g}" for level in levels_of(watched)),
            f"{100 * probability:.0f} %",
        )
        for watched, largest, end, probability in rows_of(answer.outlook)
    ]
    columns = ("Quantity", ">largest", ">of 90 %", ">at the end", "Unit", ">limits", ">probability")
    facts = [name, f"from t = {answer.outlook.now_s:.3f} s", *asked, f"{answer.outlook.rows.shape[1]} futures"]
    return write_page(path, "what_if/what_if", pictures, facts=facts, columns=columns, rows=rows, pictures=pictures)


def _picture(outlook: Outlook, place: int) -> Picture:
    watched, times_s = outlook.watched[place], outlook.times_s
    low, median, high = outlook.band(place)
    curves = [Curve("median", times_s, median, BLUE)]
    for label in ("warning", "trip"):
        level = watched.warning if label == "warning" else watched.trip
        if level is not None and level < 1.5 * float(np.max(np.abs([low, high]))):
            curves.append(Curve(label, times_s, np.full(len(times_s), level), VERMILLION, 1.0, (4.0, 3.0)))
    chart = Chart(f"{watched.name}, {watched.unit}", curves, [Band(times_s, low, high, BLUE, 0.25)])
    caption = "Median of the futures, and the band in which 90 % of what would be measured lies."
    return drawn(Picture(f"what-if-{watched.signal}", watched.name, caption, [chart]))
