"""A segment of a run that is judged on its own, the figures that any signal of it can have, and what a metric is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.runs.events import STEP_SHARE, Event, open_loops
from hilbench.runs.figures import LEAST_SETTLED_S, least_stay_s, settled_part, stays_from, still_settling, trend_rms
from hilbench.topology.main_quantities.quantity import MainQuantity

Channels = Mapping[str, NDArray[Any]]

#: An excess of at most so many times the rms of the noise is noise, no overshoot.
NOISE_PEAK: Final = 5.0


@dataclass(frozen=True)
class Figure:
    """One metric of one step: its value, or why there is none.

    `longer_than_s`: what was waited for did not come within that time, so that the value is larger.
    """

    value: float | None
    reason: str = ""
    longer_than_s: float | None = None


class UnknownFigureError(Exception):
    """A figure that cannot be determined; its text gives the reason."""


class Segment:
    """Signals from one step to the next event, and the figures they show; UnknownFigureError states why there is none.

    `part`: its samples within `channels` (by signal, of equal length); `event`: the step, None for a working window;
    `marks`: what else happened, in order of time.
    """

    def __init__(self, channels: Channels, part: slice, event: Event | None, marks: Sequence[Event] = ()) -> None:
        self._all, self._part = channels, part
        self._channels = {name: np.asarray(values[part], np.float64) for name, values in channels.items()}
        self.event = event
        self.t_s = self._channels["t_s"]
        self.hold_s = float(self.t_s[-1] - self.t_s[0])
        self.open_loops = open_loops(marks, *map(float, self.t_s[[0, -1]]))  #: tension loops that were, for long
        self.sample_s = float(np.min(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0

    def get(self, name: str) -> Array:
        """A signal, all of it numbers."""
        if name not in self._channels:
            raise UnknownFigureError(f"{name} is not recorded")
        values = self._channels[name]
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise UnknownFigureError(f"{name} is no number at t = {self.t_s[bad[0]]:g} s")
        return values

    def before(self, name: str) -> float:
        """The last value of a signal before the segment, or its first where nothing is recorded before it."""
        first = self._part.start or 0
        return float(self._all[name][first - 1]) if first and name in self._all else float(self.get(name)[0])

    def last(self, name: str) -> float:
        """The last value of a signal, NaN of one that is not recorded."""
        values = self._channels.get(name)
        return float("nan") if values is None else float(values[-1])

    def error(self, name: str, goal: str) -> Array:
        """A signal less another."""
        return self.get(name) - self.get(goal)

    def settled(self, error: Array) -> slice:
        """The end of the segment without the transient of `error`."""
        if self.hold_s < LEAST_SETTLED_S - self.sample_s:
            raise UnknownFigureError(
                f"the hold of {self.hold_s:.3g} s is too short, at least {LEAST_SETTLED_S:g} s are needed"
            )
        return settled_part(self.t_s, error)

    def final(self, error: Array) -> Figure:
        """Size of the mean of the settled part."""
        return Figure(abs(float(np.mean(error[self.settled(error)]))))

    def rms(self, error: Array) -> Figure:
        """Root of the mean square."""
        return Figure(float(np.sqrt(np.mean(error**2))))

    def peak(self, error: Array) -> Figure:
        """Largest size."""
        return Figure(float(np.max(np.abs(error))))

    def noise(self, error: Array) -> float:
        """Rms about the trend of the settled part."""
        part = self.settled(error)
        if still_settling(self.t_s, error):
            raise UnknownFigureError(f"noise is not separable from settling after the hold of {self.hold_s:.3g} s")
        return trend_rms(self.t_s[part], error[part])

    def overshoot(self, name: str, goal: str, height: float) -> Figure:
        """Largest excess of a signal over its goal beyond noise, in the direction of a step of `height`, in % of it."""
        error = self.error(name, goal)
        excess = float(np.max(error * np.sign(height)))
        beyond_noise = excess - NOISE_PEAK * self.noise(error) if excess > 0 else 0.0
        return Figure(100 * max(beyond_noise, 0.0) / abs(height))

    def time_in_band(self, error: Array, band: float, text: str) -> Figure:
        """Time until the error stays within the band; `text` is the band for a reader."""
        first = stays_from(error, band)
        if first == len(error):
            return Figure(None, f"not within {text} for good in the hold of {self.hold_s:.3g} s", self.hold_s)
        time_s = float(self.t_s[first] - self.t_s[0])
        needed_s = least_stay_s(self.hold_s)
        if self.hold_s - time_s < needed_s:
            stayed = f"within {text} for the last {self.hold_s - time_s:.2g} s of the hold only"
            raise UnknownFigureError(f"{stayed}, at least {needed_s:.2g} s are needed")
        return Figure(time_s)

    def height_of(self, quantity: MainQuantity) -> float:
        """Height of the step of a quantity: by the recording, where it shows it."""
        assert self.event is not None, "only a step has a height"
        values = self._all.get(quantity.signal)
        if values is None:
            changed = self.event.of(quantity.path)
            return 0.0 if changed is None or changed.before is None else (changed.after or 0.0) - changed.before
        time_s = np.asarray(self._all["t_s"], np.float64)
        before = int(np.searchsorted(time_s, self.event.start_s - 0.5 * self.sample_s)) - 1
        return float(values[self._part.start]) - float(values[max(before, 0)])

    def is_step_of(self, quantity: MainQuantity) -> bool:
        """True if its step is one of this quantity. The emulation may change it without a journal entry: the
        recording shows that, beyond the drift that such a quantity may have."""
        if self.event is None:
            return False
        height = self.height_of(quantity)
        if not quantity.emulated:
            return self.event.of(quantity.path) is not None and bool(height)
        values = self._all.get(quantity.signal)
        return values is not None and abs(height) > STEP_SHARE * abs(float(values[self._part.start]))


@dataclass(frozen=True)
class Metric:
    """Meaning of a metric's number: its unit, why a run may not have it, and how a segment shows it.

    `figure` is None for what is counted of the whole run; `judged` selects the segments that have a figure.
    """

    unit: str
    description: str
    absent: str
    figure: Callable[[Segment], Figure] | None = None
    judged: Callable[[Segment], bool] = lambda segment: True

    @property
    def of_steps(self) -> bool:
        """True if each step has a figure of its own."""
        return self.figure is not None


def after_a_step(segment: Segment) -> bool:
    """True for a step, not for a working window; for `Metric.judged`."""
    return segment.event is not None


def after_a_step_of(quantity: MainQuantity) -> Callable[[Segment], bool]:
    """Condition for `Metric.judged`: this quantity stepped."""
    return lambda segment: segment.is_step_of(quantity)
