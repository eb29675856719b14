"""The page of a stand's history: its quantities over days, with the band of what they are, changes and limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from hilbench.apps.history.quantities import COLUMNS, SECONDS_PER_DAY, QuantityTrend, date, figures, sentences
from hilbench.apps.report.chart import BLUE, INK, ORANGE, VERMILLION
from hilbench.apps.report.page import typeset, write_page
from hilbench.apps.report.plots import DrawnAxes, Picture

_HEIGHT_IN: Final = 2.5
_TICKS: Final = 6
_SOURCE_MARKS: Final = {"twin": "o", "diagnosis": "D"}
_CAPTION: Final = (
    "Points: runs (round: twin, square: diagnosis) with the 95 % that they state; orange: the mean and its 95 % band, "
    "beyond the dotted line what is to come; red: a change, the limit."
)


def write_history_page(stands: Mapping[str, Sequence[QuantityTrend]], path: Path) -> Path:
    """Write the page; returns its path. Raises UnusableInputError if it cannot be written."""
    shown = [
        (stand, [row(each) for each in quantities], [picture(stand, each) for each in quantities])
        for stand, quantities in stands.items()
    ]
    title = "History of " + ", ".join(stands)
    return write_page(path, "history/history", [], title=title, columns=COLUMNS, stands=shown)


def row(one: QuantityTrend) -> list[str]:
    """The table's text."""
    name, *cells = figures(one)
    return [name, *map(typeset, cells)]


def picture(stand: str, one: QuantityTrend) -> Picture:
    """The runs with what they state, the band of the mean, changes, and the limit."""

    def draw(figure: Any) -> list[DrawnAxes]:
        axes = figure.subplots(1, 1)
        panel, found = DrawnAxes(axes), one.trend
        for source, mark in _SOURCE_MARKS.items():
            rows = [each for each in one.rows if each.source == source]
            if rows:
                days = [(each.time_s - one.first_time_s) / SECONDS_PER_DAY for each in rows]
                values, deviations = np.array([(each.quantity.value, each.quantity.sd) for each in rows]).T
                axes.errorbar(
                    days, values, 1.96 * deviations, fmt=mark, color=BLUE, markersize=3.2, elinewidth=0.8, alpha=0.75
                )
        if found is not None:
            axes.fill_between(found.band_d, found.band_low, found.band_high, color=ORANGE, alpha=0.3, linewidth=0)
            axes.plot(found.band_d, found.band, color=ORANGE, linewidth=1.4)
            panel.names.append(("mean", ORANGE, float(found.band[-1])))
            last = (one.rows[-1].time_s - one.first_time_s) / SECONDS_PER_DAY
            axes.axvline(last, color=INK, linewidth=0.6, alpha=0.5, linestyle=(0, (1, 2)))
            for change in found.changes:
                if change.kind != "outlier":
                    axes.axvspan(change.after_d, change.before_d, color=VERMILLION, alpha=0.25, linewidth=0)
        if one.limit is not None:
            axes.axhline(one.limit, color=VERMILLION, linewidth=1.0)
            panel.names.append(("limit", VERMILLION, one.limit))
        ticks = [tick for tick in axes.get_xticks() if axes.get_xlim()[0] <= tick <= axes.get_xlim()[1]]
        first = {date(one.time_s(tick)): tick for tick in reversed(ticks)}  # of several ticks in a day
        dates = sorted(first)[:: max(1, len(first) // _TICKS)]
        axes.set_xticks([first[day] for day in dates], dates)
        axes.set_ylabel(one.unit or "1")
        return [panel]

    name = f"{stand}-{one.name}".replace(".", "-")
    caption = " ".join(f"{line}." for line in sentences(one)) + f" {_CAPTION}"
    alternative = f"{one.name} over days"
    return Picture(name, one.name, caption.strip(), draw=draw, height_in=_HEIGHT_IN, alternative=alternative)
