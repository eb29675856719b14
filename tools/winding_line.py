"""A grey-box model of a winding line about an operating point: tensions from what drives the line.

Unwinder and rewinder are driven by torque, the pacer between them by speed. Each tension follows from the torque
balance of its reel, seen through the web and the tension meter, both first-order lags:

    T1 = [b·(w2 - w3) + k1·i1/(1 + tau_c·s) + J·tau_s·s·(w1 + w3) + J2·tau_s·s·w2]/(1 + tau_s·s)
         + J'·tau_r·s·(w1 + w3)/(1 + tau_r·s)
    T2 = [k21·i1 + k23·i3]/(1 + tau_2·s)

with lags tau_s of span and tension meter, tau_c of the current loop, tau_r of the reels, and speeds that are recorded
late. The rewinder's speed is not an input of T2: where a drive gives torque, speed is what comes of it. All are
deviations from the operating point in whatever units the recording has (a standardized column is as good as one in N).
Structure after Bastogne, Thomassin, Masse, Control Engineering Practice 15 (2007), with the parameters that data of
such a line can tell, and no more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import lfilter

from hilbench.diagnosis.noise import NORMAL_95, repeats

Array = NDArray[np.float64]

#: Time constants at which the fit begins, s.
_START_S: Final = {"span_lag_s": 0.5, "speed_late_s": 0.0, "current_lag_s": 0.1, "reel_lag_s": 0.12}
_START_2_S: Final = 0.2
_SHORTEST_S: Final = 1e-3
#: Substeps of a set point's hold in which two lags in series are simulated.
_SUBSTEPS: Final = 20
#: Variance inflation from which a parameter can't be separated from the others.
_COLLINEAR: Final = 10.0
_STEP: Final = 1e-4


@dataclass(frozen=True)
class LineRecording:
    """Deviations from the operating point, (n,) each, evenly sampled."""

    period_s: float
    unwinder_speed: Array
    pacer_speed: Array
    rewinder_speed: Array
    unwinder_current: Array
    rewinder_current: Array
    tension_1: Array
    tension_2: Array


#: From a recording and time constants (s, by name) to what each gain multiplies, (n,) each.
Regressors = Callable[[LineRecording, Mapping[str, float]], dict[str, Array]]


@dataclass(frozen=True)
class LineParameter:
    """A parameter with its standard deviation, and its collinearity with the others (variance inflation)."""

    name: str
    value: float
    deviation: float
    variance_inflation: float

    @property
    def is_identified(self) -> bool:
        """True if the data identify it: significantly not zero, and not collinear with the others."""
        return abs(self.value) > NORMAL_95 * self.deviation and self.variance_inflation < _COLLINEAR


@dataclass(frozen=True)
class LineFit:
    """The fitted line; tensions of a free run over the whole recording, (2, n); VAF, %, of the rows held out."""

    parameters: list[LineParameter]
    tensions: Array
    vaf_percent: tuple[float, float]


def vaf_percent(measured: Array, predicted: Array) -> float:
    """Variance accounted for: 100·(1 - var(measured - predicted)/var(measured)); -inf where nothing varies."""
    variance = float(np.var(measured))
    return 100.0 * (1.0 - float(np.var(measured - predicted)) / variance) if variance > 0.0 else float("-inf")


def fit_line(line: LineRecording, train: slice, test: slice) -> LineFit:
    """Fit to the rows of `train`; `test` is run freely, without any of its tensions.

    Time constants by Gauss-Newton, gains by linear least squares at each of its steps (variable projection).
    """
    first = _Tension(_tension_1, _START_S, line, line.tension_1, train)
    second = _Tension(_tension_2, {"span_2_lag_s": _START_2_S}, line, line.tension_2, train)
    tensions = np.array([first.predicted, second.predicted])
    measured = np.array([line.tension_1, line.tension_2])
    vaf = [vaf_percent(measured[k, test], tensions[k, test]) for k in range(2)]
    return LineFit([*first.parameters(), *second.parameters()], tensions, (vaf[0], vaf[1]))


def _tension_1(line: LineRecording, times: Mapping[str, float]) -> dict[str, Array]:
    """Regressors of the gains of tension 1."""
    step, late_s = line.period_s, times["speed_late_s"]
    reels, pacer, rewinder = (
        _earlier(speed, late_s / step)
        for speed in (line.unwinder_speed + line.rewinder_speed, line.pacer_speed, line.rewinder_speed)
    )
    span_s, reel_s = max(times["span_lag_s"], _SHORTEST_S), max(times["reel_lag_s"], _SHORTEST_S)
    return {
        "draw_friction": lag(pacer - rewinder, span_s, step),
        "unwinder_torque_1": held_lags(line.unwinder_current, span_s, max(times["current_lag_s"], _SHORTEST_S), step),
        "reel_inertia": reels - lag(reels, span_s, step),
        "pacer_inertia": pacer - lag(pacer, span_s, step),
        "reel_inertia_lagged": reels - lag(reels, reel_s, step),
    }


def _tension_2(line: LineRecording, times: Mapping[str, float]) -> dict[str, Array]:
    """Regressors of the gains of tension 2."""
    lag_s = max(times["span_2_lag_s"], _SHORTEST_S)
    return {
        "unwinder_torque_2": held_lag(line.unwinder_current, lag_s, line.period_s),
        "rewinder_torque_2": held_lag(line.rewinder_current, lag_s, line.period_s),
    }


class _Tension:
    """One tension's fit: time constants and gains."""

    def __init__(
        self, regressors: Regressors, start_s: Mapping[str, float], line: LineRecording, measured: Array, train: slice
    ) -> None:
        self._regressors, self._line, self._measured, self._train = regressors, line, measured, train
        self._times = tuple(start_s)
        solution = least_squares(self._misfit, list(start_s.values()), x_scale=0.1)
        times_s = dict(zip(self._times, solution.x, strict=True))
        columns = regressors(line, times_s)
        gains = self._gains(columns)
        self._values = np.concatenate([solution.x, gains])
        self._names = (*self._times, *columns)
        self.predicted = gains @ np.array(list(columns.values()))

    def _gains(self, columns: Mapping[str, Array]) -> Array:
        matrix = np.array(list(columns.values()))[:, self._train].T
        return np.asarray(np.linalg.lstsq(matrix, self._measured[self._train], rcond=None)[0])

    def _run(self, values: Array) -> Array:
        """Tension of a free run over the rows to fit."""
        times_s = dict(zip(self._times, values, strict=False))
        columns = np.array(list(self._regressors(self._line, times_s).values()))
        return np.asarray(values[len(self._times) :] @ columns[:, self._train])

    def _misfit(self, times: Array) -> Array:
        columns = self._regressors(self._line, dict(zip(self._times, times, strict=True)))
        predicted = self._gains(columns) @ np.array(list(columns.values()))
        return np.asarray((self._measured - predicted)[self._train])

    def parameters(self) -> list[LineParameter]:
        """Parameters with deviations that grow with the autocorrelation of the residual."""
        columns = []
        for k in range(len(self._values)):
            moved = self._values.copy()
            moved[k] += _STEP
            columns.append((self._run(moved) - self._run(self._values)) / _STEP)
        jacobian = np.array(columns)
        residual = self._measured[self._train] - self._run(self._values)
        information = jacobian @ jacobian.T
        inverse = np.linalg.pinv(information)
        variance = np.var(residual) * repeats(residual)
        return [
            LineParameter(
                name,
                float(value),
                float(np.sqrt(max(variance * inverse[k, k], 0.0))),
                float(inverse[k, k] * information[k, k]),
            )
            for k, (name, value) in enumerate(zip(self._names, self._values, strict=True))
        ]


def lag(values: Array, lag_s: float, period_s: float) -> Array:
    """A first-order lag of what goes straight from sample to sample; from rest at the first, (n,)."""
    a = np.exp(-period_s / lag_s)
    rise = (1.0 - a) * lag_s / period_s
    return np.asarray(lfilter([1.0 - rise, rise - a], [1.0, -a], values - values[0]) + values[0])


def held_lag(values: Array, lag_s: float, period_s: float) -> Array:
    """A first-order lag of a set point that is held from sample to sample, (n,)."""
    a = np.exp(-period_s / lag_s)
    return np.asarray(lfilter([0.0, 1.0 - a], [1.0, -a], values - values[0]) + values[0])


def held_lags(values: Array, one_s: float, other_s: float, period_s: float) -> Array:
    """Two lags in series of a set point that is held, (n,); also for equal ones."""
    fine_s = period_s / _SUBSTEPS
    fine = np.repeat(values, _SUBSTEPS)
    return lag(held_lag(fine, one_s, fine_s), other_s, fine_s)[::_SUBSTEPS]


def _earlier(values: Array, rows: float) -> Array:
    """Signal shifted earlier by some rows: one that was recorded late."""
    at = np.arange(len(values), dtype=np.float64)
    return np.asarray(np.interp(at + rows, at, values))
