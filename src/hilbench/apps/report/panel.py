"""Panels of a kind of machine: which quantities are drawn together, under which title, in which unit, in which bands.

Described once (`MachinePanels`): a report draws them of a recording, the page of a running bench as they come, the
terminal has rows of them, and runs are compared by them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from hilbench.apps.report.chart import INK, SKY, VERMILLION, Band, Chart, Curve
from hilbench.apps.report.reduce import mean_velocity, moving_average
from hilbench.arrays import Array
from hilbench.machine_kinds import machine_part
from hilbench.results.recording import Recording
from hilbench.runs.figures import ESTIMATE_BAND
from hilbench.topology.main_quantities.quantity import ESTIMATED, OF_THE_MODEL, MainQuantity, text_of_deviation
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape, kind_of, shape_of

#: Strokes and gaps: of commands, of set-points and what is not estimated.
COMMAND_DASH: Final = (4.0, 4.0)
DASHED: Final = (4.0, 2.0)
#: In place of the estimate that the published synchronizer would have made of a run.
REFERENCE: Final = "reference"

#: Time over which velocities and torques are averaged for the eye, s (the publication: 20 values, 20 ms apart).
SMOOTHING_S: Final = 0.4


@dataclass(frozen=True)
class ShownRun:
    """A recording with what is needed to draw it.

    `breaks`: samples at which something happened, over which nothing is averaged; `reference`: what the published
    synchronizer would have made of the run, in SI, where the machine has one.
    """

    recording: Recording
    breaks: Sequence[int] = ()
    reference: Array | None = None

    @classmethod
    def of(cls, recording: Recording, times_s: ArrayLike, reference: Array | None = None) -> Self:
        """A recording in which something happened at these times, or began and ended."""
        return cls(recording, np.unique(np.searchsorted(recording.time_s, times_s)).tolist(), reference)

    def __contains__(self, name: object) -> bool:
        return name in self.recording or (name == REFERENCE and self.reference is not None)

    @property
    def t_s(self) -> Array:
        """The time base."""
        return self.recording.time_s

    @property
    def width(self) -> int:
        """Samples of an average."""
        return max(round(SMOOTHING_S / float(np.min(np.diff(self.recording.time_s)))), 1)

    def get(self, name: str) -> Array:
        """A signal, or the reference, SI."""
        return np.asarray(self.reference if name == REFERENCE else self.recording[name], np.float64)

    def averaged(self, name: str) -> Array:
        """Its moving average."""
        return moving_average(self.get(name), self.width, self.breaks)

    def velocity(self, position: str) -> Array:
        """The averaged velocity of a position."""
        return mean_velocity(self.t_s, self.get(position), self.width, self.breaks)


#: How the values of a signal come from a run.
Values = Callable[[ShownRun, str], Array]
AS_RECORDED: Final[Values] = ShownRun.get
AVERAGED: Final[Values] = ShownRun.averaged


@dataclass(frozen=True)
class Series:
    """Drawing of one signal: its name beside it ("": none), and what of it a report shows (`values`); of a noisy one
    (`spread`) paper has the area between its extremes.

    `deviation`: the signal of its standard deviation where it is shown only while that is finite (`estimated`), or only
    while it is infinite.
    """

    signal: str
    name: str
    colour: str
    width: float = 1.4
    dash: tuple[float, ...] = ()
    alpha: float = 1.0
    spread: bool = False
    values: Values = AS_RECORDED
    deviation: str = ""
    estimated: bool = True

    def curve(self, run: ShownRun, si_per_unit: float) -> Curve | None:
        """Curve of a run, in a unit of so many SI units; None where there is nothing to show."""
        if self.signal not in run:
            return None
        values = self.values(run, self.signal) / si_per_unit
        is_shown = np.full(len(values), self.estimated)
        if self.deviation in run:
            is_shown = np.isinf(run.get(self.deviation)) != self.estimated
        if not is_shown.any():
            return None
        values = values if is_shown.all() else np.where(is_shown, values, np.nan)
        return Curve(self.name, run.t_s, values, self.colour, self.width, self.dash, self.alpha, self.spread)


@dataclass(frozen=True)
class Interval:
    """A band around a signal: a share of it to either side, or two standard deviations, by the signal of that."""

    signal: str
    colour: str
    alpha: float
    share: float = 0.0
    deviation: str = ""

    def band(self, run: ShownRun, si_per_unit: float) -> Band | None:
        """Band of a run, in a unit of so many SI units; None where signals are missing. No band is drawn where the
        deviation is infinite."""
        if self.signal not in run or (self.deviation and self.deviation not in run):
            return None
        values = run.get(self.signal) / si_per_unit
        half = self.share * np.abs(values)
        if self.deviation:
            deviation = run.get(self.deviation)
            half = 2 * np.where(np.isinf(deviation), np.nan, deviation) / si_per_unit
        return Band(run.t_s, values - half, values + half, self.colour, self.alpha)


def tolerance(signal: str) -> Interval:
    """The band about a true value that a criterion goes by."""
    return Interval(signal, INK, 0.16, share=ESTIMATE_BAND)


@dataclass(frozen=True)
class Row:
    """A panel in the terminal's live table: what is before the names of its series, the format of each number, and
    where they are not all shown the signal that is."""

    subject: str
    form: str
    signal: str = ""


@dataclass(frozen=True)
class Compared:
    """Quantity by which runs are compared: the first of the signals that a run has, as `values` of it (None: none)."""

    title: str
    signals: Sequence[str]
    values: Callable[[ShownRun, str], Array | None] = AS_RECORDED

    def of(self, run: ShownRun) -> Array | None:
        """Values of a run, SI."""
        found = next((name for name in self.signals if name in run), None)
        return None if found is None else self.values(run, found)


@dataclass(frozen=True)
class Panel:
    """Quantities that are drawn together over time, in a unit of so many SI units.

    `quantity`: what the axis is labelled with; a height of at least `least`, and `least_share` of the largest value, is
    shown. A report has those with a caption, as pictures called `name`, none without the signals in `needs`, with
    further axes `below`, and shown around each step, too, where `zoomed`; the page of a running bench those that are
    `live`, with the levels of one of the config's `limits`. `steps`: figures of each step that the terminal has room
    for, by heading and metric.
    """

    name: str
    title: str
    quantity: str
    unit: str
    series: Sequence[Series] = ()
    bands: Sequence[Interval] = ()
    si_per_unit: float = 1.0
    least: float = 0.0
    least_share: float = 0.0
    needs: Sequence[str] = ()
    caption: str = ""
    with_reference: str = ""  #: said beside the caption where there is a reference
    below: Callable[[ShownRun], Chart | None] = lambda run: None
    zoomed: bool = False
    live: bool = True
    limits: str = ""
    row: Row | None = None
    steps: Sequence[tuple[str, str]] = ()
    compared: Compared | None = None

    @property
    def label(self) -> str:
        """Label of the axis."""
        return f"{self.quantity} in {self.unit}"

    def words(self, run: ShownRun) -> str:
        """The caption."""
        return f"{self.caption} {self.with_reference if run.reference is not None else ''}".strip()

    def charts(self, run: ShownRun) -> list[Chart]:
        """Charts of a recording, axes one below the other."""
        if any(name not in run for name in self.needs):
            return []
        curves = [curve for each in self.series if (curve := each.curve(run, self.si_per_unit)) is not None]
        bands = [band for each in self.bands if (band := each.band(run, self.si_per_unit)) is not None]
        known = [np.abs(run.get(name)) for name in self.needs if self.least_share]
        largest = max((float(np.max(each, initial=0.0, where=np.isfinite(each))) for each in known), default=0.0)
        least = max(self.least, self.least_share * largest / self.si_per_unit)
        top = Chart(self.label, curves, bands, least=least) if curves else None
        return [chart for chart in (top, self.below(run)) if chart is not None]

    def text(self, sample: CycleSample, known: Collection[str]) -> tuple[str, str] | None:
        """Heading and values of its row, of the `known` signals; None without one."""
        if self.row is None:
            return None
        shown = [each for each in self.series if each.estimated and each.signal in known]
        names = [text_of_deviation(getattr(sample, each.deviation)) if each.deviation else each.name for each in shown]
        signals = [each.signal for each in shown]
        if self.row.signal:
            names, signals = [], [self.row.signal]
        values = (format(getattr(sample, name) / self.si_per_unit, self.row.form) for name in signals)
        return f"{self.row.subject} {' / '.join(names)}".strip(), f"{' / '.join(values)} {self.unit}"


def estimate(
    quantity: MainQuantity, name: str, title: str, caption: str, row: Row, *, reference: str = "", **further: Any
) -> Panel:
    """Panel of what the twin estimates of a quantity of the emulated machine: its truth with the band that a criterion
    goes by, and two standard deviations where the twin states one; at least as high as that band. Where nothing shows
    it, the legend says that it is the model's."""
    signal, deviation = quantity.twin_signal, quantity.twin_deviation
    series = (
        Series(quantity.signal, "true", INK, 1.1),
        *((Series(REFERENCE, "PID", SKY),) if reference else ()),
        Series(signal, ESTIMATED, VERMILLION, deviation=deviation),
        *(
            (Series(signal, OF_THE_MODEL, VERMILLION, dash=DASHED, deviation=deviation, estimated=False),)
            if deviation
            else ()
        ),
    )
    stated = (Interval(signal, VERMILLION, 0.25, deviation=deviation),) if deviation else ()
    return Panel(
        name,
        title,
        quantity.short,
        quantity.in_unit,
        series,
        (tolerance(quantity.signal), *stated),
        quantity.si_per_shown,
        least_share=2 * ESTIMATE_BAND,
        needs=(signal,),
        caption=caption,
        with_reference=reference,
        zoomed=True,
        row=row,
        **further,
    )


@dataclass(frozen=True)
class MachinePanels:
    """The panels of a kind of machine, in the order in which they are shown. `reference`: what the published
    synchronizer would have made of a run, by the run's config and recording, where there is one for this machine."""

    panels: Sequence[Panel]
    reference: Callable[[Path, Recording], Array | None] = lambda config, recording: None

    @property
    def pictures(self) -> Iterator[Panel]:
        """Panels of a report."""
        return (panel for panel in self.panels if panel.caption)


def panels_of(kind: str, shape: Shape) -> MachinePanels:
    """Panels of a kind of machine with these parts."""
    panels: MachinePanels = machine_part(kind, "panels")(shape)
    return panels


def recorded_panels(recording: Recording) -> MachinePanels:
    """Panels of the machine whose signals are recorded."""
    return panels_of(kind_of(recording.channels), shape_of(recording.channels))
