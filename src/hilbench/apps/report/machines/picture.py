"""What a table of pictures is made of: which signals stand together, under which title, in which unit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.report.chart import INK, SKY, VERMILLION, Band, Chart, Curve
from hilbench.apps.report.reduce import mean_velocity, moving_average
from hilbench.results.recording import Recording
from hilbench.runs.figures import ESTIMATE_BAND
from hilbench.topology.main_quantities.quantity import ESTIMATED, OF_THE_MODEL, MainQuantity

Array = NDArray[np.float64]

_OF_MODEL: Final = (4.0, 2.0)  #: dashes of what is not estimated

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

    def __contains__(self, name: object) -> bool:
        return name in self.recording

    @property
    def t_s(self) -> Array:
        """The time base."""
        return self.recording.time_s

    @property
    def width(self) -> int:
        """Samples of an average."""
        return max(round(SMOOTHING_S / float(np.min(np.diff(self.recording.time_s)))), 1)

    def get(self, name: str) -> Array:
        """A signal, SI."""
        return np.asarray(self.recording[name], np.float64)

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
class Line:
    """How one signal is drawn: its name beside it ("": none), and what of it is shown."""

    signal: str
    name: str
    colour: str
    width: float = 1.4
    dash: tuple[float, ...] = ()
    alpha: float = 1.0
    spread: bool = False
    values: Values = AS_RECORDED


#: A set of axes of a run; None where signals are missing.
MakeChart = Callable[[ShownRun], Chart | None]


def lines(label: str, *shown: Line, si_per_unit: float = 1.0, least: float = 0.0) -> MakeChart:
    """Axes with the signals that the recording has, in a unit of so many SI units; none of them without the first."""

    def make(run: ShownRun) -> Chart | None:
        curves = [
            Curve(
                line.name,
                run.t_s,
                line.values(run, line.signal) / si_per_unit,
                line.colour,
                line.width,
                line.dash,
                line.alpha,
                line.spread,
            )
            for line in shown
            if line.signal in run
        ]
        return Chart(label, curves, least=least) if curves else None

    return make


def estimate(quantity: MainQuantity) -> MakeChart:
    """Axes with what the twin estimates of a quantity of the emulated machine, its truth with the band that a criterion
    goes by, and two standard deviations where the twin states one; at least as high as that band. Where nothing tells
    it, the legend says that it is the model's."""
    scale, signal, deviation = quantity.si_per_shown, quantity.twin_signal, quantity.twin_deviation

    def make(run: ShownRun) -> Chart | None:
        if signal not in run:
            return None
        estimated = run.get(signal) / scale
        curves, bands = [], []
        is_stated = ~np.isinf(run.get(deviation)) if deviation in run else np.full(len(estimated), True)
        if quantity.signal in run:
            true = run.get(quantity.signal) / scale
            bands.append(Band(run.t_s, true * (1 - ESTIMATE_BAND), true * (1 + ESTIMATE_BAND), INK, 0.16))
            curves.append(Curve("true", run.t_s, true, INK, 1.1))
        if deviation in run:
            spread = np.where(is_stated, run.get(deviation), np.nan) / scale
            bands.append(Band(run.t_s, estimated - 2 * spread, estimated + 2 * spread, VERMILLION, 0.25))
        if run.reference is not None:
            curves.append(Curve("PID", run.t_s, run.reference / scale, SKY))
        if is_stated.any():
            curves.append(Curve(ESTIMATED, run.t_s, np.where(is_stated, estimated, np.nan), VERMILLION))
        if not is_stated.all():
            curves.append(
                Curve(OF_THE_MODEL, run.t_s, np.where(is_stated, np.nan, estimated), VERMILLION, dash=_OF_MODEL)
            )
        least = 2 * ESTIMATE_BAND * float(np.max(np.abs(estimated), initial=0.0, where=np.isfinite(estimated)))
        return Chart(f"{quantity.short} in {quantity.in_unit}", curves, bands, least=least)

    return make


@dataclass(frozen=True)
class RunPicture:
    """One picture of a run: its axes one below the other, none without the signals in `needs`.

    `with_reference` is said beside the caption where there is a reference; `zoomed`: shown around each step, too.
    """

    name: str
    title: str
    caption: str
    axes: Sequence[MakeChart]
    needs: Sequence[str] = ()
    with_reference: str = ""
    zoomed: bool = False

    def words(self, run: ShownRun) -> str:
        """The caption."""
        return self.caption + (f" {self.with_reference}" if self.with_reference and run.reference is not None else "")

    def charts(self, run: ShownRun) -> list[Chart]:
        """What the recording has of it."""
        if any(name not in run for name in self.needs):
            return []
        return [chart for make in self.axes if (chart := make(run)) is not None]


@dataclass(frozen=True)
class ComparedSignal:
    """What runs are compared by: the first of the signals that a run has, as `values` of it (None: it has none)."""

    name: str
    title: str
    label: str
    signals: Sequence[str]
    si_per_unit: float = 1.0
    values: Callable[[ShownRun, str], Array | None] = AS_RECORDED

    def of(self, run: ShownRun) -> Array | None:
        """In the unit of the label."""
        found = next((name for name in self.signals if name in run), None)
        values = None if found is None else self.values(run, found)
        return None if values is None else values / self.si_per_unit


@dataclass(frozen=True)
class MachinePictures:
    """The pictures of a kind of machine. `reference`: what the published synchronizer would have made of a run, by the
    run's config and recording, where there is one for this machine."""

    pictures: Sequence[RunPicture]
    compared: Sequence[ComparedSignal]
    reference: Callable[[Path, Recording], Array | None] = field(default=lambda config, recording: None)
