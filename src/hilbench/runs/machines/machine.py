"""Metrics of the runs of a kind of machine, and those that follow from the signals that every kind has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isinf

import numpy as np

from hilbench.arrays import Array
from hilbench.runs.figures import ESTIMATE_BAND, noise_pct, still_settling
from hilbench.runs.segment import NOISE_PEAK, Figure, Metric, Segment, UnknownFigureError, after_a_step, after_a_step_of
from hilbench.topology.main_quantities.quantity import MainQuantity

NO_STEP = "nothing stepped, or signals that it needs are not recorded"

#: Half width of the band that a speed has to enter, as a share of its step.
_SPEED_BAND = 0.02


@dataclass(frozen=True)
class MachineMetrics:
    """Metrics of a kind of machine.

    The command of `speed` shows when the machine works; where its ramps are the work itself (`moves_always`), they end
    no segment. `together`: groups of figures of one step, that whose last one is the largest.
    """

    speed: MainQuantity
    metrics: Mapping[str, Metric]
    together: tuple[tuple[str, ...], ...] = ()
    moves_always: bool = False


def nothing_to_judge(machine: str) -> str:
    """Why a run may not have what every step has; `machine` is what has to run."""
    return f"nothing stepped and the {machine} never ran, or signals that it needs are not recorded"


@dataclass(frozen=True)
class Estimate:
    """A property of the emulated machine that the twin estimates."""

    quantity: MainQuantity
    machine: str  #: what has to run

    @property
    def signal(self) -> str:
        """Signal of the twin."""
        return self.quantity.twin_signal

    def metrics(self) -> dict[str, Metric]:
        """Time to 1 %, final error, noise and overshoot, by names that begin with the symbol of the signals."""
        name, symbol = self.quantity.short, self.signal.split("_sim_", 1)[0]
        nothing = nothing_to_judge(self.machine)
        return {
            f"{symbol}_time_to_1pct_s": Metric(
                "s",
                f"time from a step until the estimate stays within 1 % of the true {name}",
                NO_STEP,
                lambda s: s.time_in_band(self._error(s), ESTIMATE_BAND, f"{100 * ESTIMATE_BAND:g} %"),
                after_a_step,
            ),
            f"{symbol}_final_error_pct": Metric(
                "%",
                f"size of the mean relative error of the estimate of {name}, settled part",
                nothing,
                lambda s: s.final(100 * self._error(s)),
            ),
            f"{symbol}_noise_pct": Metric(
                "%", f"rms of the estimate of {name} about its straight-line trend, settled part", nothing, self._noise
            ),
            f"{symbol}_overshoot_pct": Metric(
                "%",
                f"largest excess of the estimate over the new {name} beyond noise, % of the step",
                f"{name} did not step, or {self.signal} is not recorded",
                lambda s: s.overshoot(self.signal, self.quantity.signal, s.height_of(self.quantity)),
                after_a_step_of(self.quantity),
            ),
        }

    def _error(self, segment: Segment) -> Array:
        """Relative."""
        if isinf(segment.last(self.quantity.twin_deviation)):
            raise UnknownFigureError(f"nothing tells {self.quantity.short}: the twin’s is that of its model")
        estimate, true = segment.get(self.signal), segment.get(self.quantity.signal)
        if not true.all():
            raise UnknownFigureError(f"the true {self.quantity.short} is 0")
        return np.asarray(estimate / true - 1, np.float64)

    def _noise(self, segment: Segment) -> Figure:
        error = self._error(segment)
        part = segment.settled(error)
        if still_settling(segment.t_s, error):
            raise UnknownFigureError(f"the estimate still settles at the end of the hold of {segment.hold_s:.3g} s")
        signals = segment.get(self.signal)[part], segment.get(self.quantity.signal)[part]
        return Figure(noise_pct(segment.t_s[part], *signals))


def speed_metrics(speed: MainQuantity, follower: str, measured: str) -> dict[str, Metric]:
    """Metrics of a velocity that follows a step of the speed: `measured` is its signal, `follower` its name."""
    absent = f"the {speed.title} did not step, or {measured} is not recorded"

    def settling(segment: Segment) -> Figure:
        error = segment.error(measured, speed.signal)
        band = max(_SPEED_BAND * abs(segment.height_of(speed)), NOISE_PEAK * segment.noise(error))
        return segment.time_in_band(error, band, f"{band:.3g} {speed.unit}")

    return {
        "speed_settling_s": Metric(
            "s",
            f"time from a step of the {speed.title} until {follower} stays within 2 % of the step",
            absent,
            settling,
            after_a_step_of(speed),
        ),
        "speed_overshoot_pct": Metric(
            "%",
            f"largest excess of {follower} over the new {speed.title} beyond noise, % of the step",
            absent,
            lambda s: s.overshoot(measured, speed.signal, s.height_of(speed)),
            after_a_step_of(speed),
        ),
    }
