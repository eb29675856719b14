"""Prediction on the measured motion: the torque that it needs, whatever loops made the axis move so."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.signal import butter, sosfiltfilt

from hilbench.diagnosis import machines
from hilbench.diagnosis.measured import STANDSTILL_M_S, Measured
from hilbench.diagnosis.misfit import Condition
from hilbench.diagnosis.noise import NORMAL_95, floor
from hilbench.diagnosis.presliding import Presliding, presliding, unseen
from hilbench.plant.model_file import Machine

Array = NDArray[np.float64]

#: Speed below which an axis stands at least, as a share of its usual highest speed.
_STANDSTILL_SHARE: Final = 0.02
#: Share of the measured acceleration's variance that may be the encoder's noise. By as much an inertia is found too
#: small: noise in a regressor pulls its coefficient to zero.
_NOISE_SHARE: Final = 1e-3
#: Corners of the filter, Hz: highest, lowest, and the ratio of one that is tried to the next.
_HIGHEST_HZ, _LOWEST_HZ, _FINER = 60.0, 5.0, 0.9
#: How far the filter smears what happens at standstill, in periods of its corner; time, in the same, within which an
#: axis that reverses passes through standstill: what is predicted passes it as fast, in the same filter. The same
#: where it is known how friction turns over.
_REACH, _PASSES, _TURNS_OVER = 1.5, 0.5, 4.0
#: Share of the inertia to which a right model may have it, one standard deviation.
_INERTIA_KNOWN: Final = 0.02
#: Corner as a share of the Nyquist frequency, and rows per period of it.
_OF_NYQUIST, _ROWS_PER_PERIOD = 0.8, 4.0


@dataclass(frozen=True)
class MotionFilter:
    """A zero-phase low pass for everything that is compared, so that nothing is shifted in time.

    As in identification of robots by inverse dynamics (Gautier, Janot): position is differentiated after it.
    """

    corner_hz: float
    period_s: float

    def smooth(self, values: Array) -> Array:
        """Values (…, n), filtered forward and backward."""
        return np.asarray(sosfiltfilt(self._sections, values))

    @cached_property
    def _sections(self) -> Array:
        return np.asarray(butter(4, self.corner_hz * 2.0 * self.period_s, output="sos"))

    def acceleration(self, position: Array) -> Array:
        """Second derivative of a position (n,), per s²."""
        return np.gradient(np.gradient(self.smooth(position), self.period_s), self.period_s)

    @classmethod
    def for_position(cls, position: Array, period_s: float) -> MotionFilter:
        """The widest filter with which the noise of a measured position (n,) hardly shows in the acceleration."""
        return cls._widest(position_noise(position), period_s, position, cls.acceleration)

    @classmethod
    def for_speed(cls, speed: Array, period_s: float) -> MotionFilter:
        """The same of a measured speed (n,)."""
        return cls._widest(position_noise(speed), period_s, speed, cls.rate)

    def rate(self, values: Array) -> Array:
        """First derivative of values (n,), per s."""
        return np.gradient(self.smooth(values), self.period_s)

    @classmethod
    def _widest(
        cls, noise: float, period_s: float, measured: Array, acceleration: Callable[[MotionFilter, Array], Array]
    ) -> MotionFilter:
        corner = min(_HIGHEST_HZ, _OF_NYQUIST * 0.5 / period_s)
        impulse = np.zeros(2 * round(2.0 / _LOWEST_HZ / period_s) + 1)
        impulse[len(impulse) // 2] = 1.0
        while True:
            found = cls(corner, period_s)
            carried = noise**2 * float(np.sum(acceleration(found, impulse) ** 2))
            if carried <= _NOISE_SHARE * float(np.var(acceleration(found, measured))) or corner <= _LOWEST_HZ:
                return found
            corner = max(_FINER * corner, _LOWEST_HZ)


def position_noise(position: Array) -> float:
    """Standard deviation of the noise of a measured position or speed (n,): white, or counts, whichever is more."""
    steps = np.abs(np.diff(position))
    counts = steps[steps > 1e-9 * max(float(np.ptp(position)), 1e-300)]
    count = float(np.min(counts)) if len(counts) else 0.0
    return max(floor(position), count / float(np.sqrt(12.0)))


class OnMeasuredMotion:
    """The torque that the measured motion of a lone axis needs; no control loop has to be known.

    Motion and torque pass the same filter, which is as wide as the encoder's noise allows.
    """

    def __init__(self, model: Machine, data: Measured, wider: OnMeasuredMotion | None = None) -> None:
        """`wider`: the one of which this has half the corner; without it as wide as the position's noise allows."""
        self._model, self._data = model, data
        self.names = ("tau1_Nm",)
        self.imitation = None
        self._period_s = data.period_s
        self._filter = _filter_for(data) if wider is None else MotionFilter(0.5 * wider.corner_hz, data.period_s)
        self._x = self._filter.smooth(data.x_m[1])
        self._v = np.gradient(self._x, data.period_s)
        self._a = np.gradient(self._v, data.period_s)
        self.exact = False
        self.tolerances = np.zeros(1)
        self.every = max(1, round(1.0 / (_ROWS_PER_PERIOD * self.corner_hz) / data.period_s))
        torque = self._filter.smooth(data.tau_Nm[1])
        self.measured = torque[None, :: self.every]
        self._noise_Nm = floor(data.tau_Nm[1]) * float(np.sqrt(2.0 * self.corner_hz * data.period_s))
        self._torque = torque
        self._memory_s: float = 0.0 if wider is None else wider._memory_s
        self.presliding: Presliding | None = self._presliding() if wider is None else wider.presliding
        self.rows = self._rows()
        self._t_s = data.t_s

    @property
    def corner_hz(self) -> float:
        """Of the filter."""
        return self._filter.corner_hz

    @property
    def narrower(self) -> OnMeasuredMotion:
        """The same with half the corner."""
        return OnMeasuredMotion(self._model, self._data, self)

    def beside_swinging(self, swinging: Array, memory_s: float) -> OnMeasuredMotion:
        """The same, with rows that count once the swing of before the recording is forgotten, and the way over which
        friction turns over looked for again beside what swings.

        swinging (1 + J, P): parameters without it, and each with something of it, of which any multiple may be there.
        """
        result = copy(self)
        result._memory_s = memory_s
        without, *torques = self._required(swinging)
        result.presliding = result._presliding(np.array(torques) - without)
        result.rows = result._rows()
        return result

    def _presliding(self, beside: Array | None = None) -> Presliding | None:
        """How friction turns over at reversals, however long they take; beside other torques (J, n)."""
        rows = self._moving(len(self._x) * self._period_s * self.corner_hz)
        motion = (self._x, self._v, self._a)
        return presliding(motion, self._torque, self._filter.smooth, rows, self.every, beside)

    def _rows(self) -> NDArray[np.bool_]:
        """(n,): those that count, of those that are compared."""
        return self._moving(_PASSES if self.presliding is None else _TURNS_OVER)[:: self.every]

    def _moving(self, passes: float) -> NDArray[np.bool_]:
        """(n,): where the axis moves, and no standstill, gap or end of the recording is within reach of the filter.

        passes: periods of the corner within which a reversal is no standstill.
        """
        usual = float(np.quantile(np.abs(self._v), 0.99))
        stands = np.abs(self._v) < max(STANDSTILL_M_S, _STANDSTILL_SHARE * usual)
        stands &= ~_passing(self._v, stands, round(passes / self.corner_hz / self._period_s))
        unknown = ~self._data.usable()
        stands |= _with_surroundings(unknown)
        stands[[0, -1]] = unknown[0] = True
        for _, end in _runs(unknown):
            stands[end : end + round(self._memory_s / self._period_s)] = True
        return ~binary_dilation(stands, iterations=round(_REACH / self.corner_hz / self._period_s))

    def floor(self, signal: int) -> float:
        """What of the measured torque is above the band in which motion is known, carried into the band as white."""
        return self._noise_Nm

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time and motion. Before friction slides, and within a play, it depends on the way since the last reversal."""
        step, unit = slice(None, None, self.every), self._model.position_unit
        return [
            Condition("time", "s", self._t_s[step], spectral=True),
            Condition("speed of axis 1", f"{unit}/s", self._v[step]),
            Condition("acceleration of axis 1", f"{unit}/s²", self._a[step]),
            Condition("position of axis 1", unit, self._x[step], spectral=True),
            Condition("way since the last reversal of axis 1", unit, self._since_reversal()[step]),
        ]

    def _since_reversal(self) -> Array:
        """(n,): how far the axis has gone in its present direction, with the sign of it."""
        turns = np.concatenate([[0], np.flatnonzero(np.diff(np.sign(self._v))) + 1, [len(self._v)]])
        return np.asarray(self._x - np.repeat(self._x[turns[:-1]], np.diff(turns)))

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, 1, n): torque by the laws, filtered as the measurement is."""
        return self._required(parameters)[:, None, :: self.every]

    def doubts(self, parameters: Array) -> Array:
        """(shapes, 1, n): by what a right prediction may be off beside the noise, each to one standard deviation.

        A rigid inertia that the model has not, a torque that is read some time within a row, what the filter takes
        twice of a motion near its corner, and friction that turns over a way too short to be seen, or as sure as that
        is known.
        """
        inertia_Nm = _INERTIA_KNOWN * machines.Nm_per_acceleration(self._model, 1) * self._filter.smooth(self._a)
        here = self._required(parameters)[0]
        other = copy(self)
        if self.presliding is None:
            other.presliding = unseen(float(np.ptp(self._x)))
        else:
            way, (_, most) = self.presliding.way, self.presliding.ci95
            other.presliding = Presliding(way + (most - way) / NORMAL_95, self.presliding.ci95)
        turning_Nm = other._required(parameters)[0] - here
        shapes = np.array([inertia_Nm, 0.5 * np.gradient(here), here - self._filter.smooth(here), turning_Nm])
        return shapes[:, None, :: self.every]

    def _required(self, parameters: Array) -> Array:
        """(B, P) to (B, n): the same at every row of the recording."""
        many = np.atleast_2d(parameters)
        torque = np.empty((len(many), len(self._x)))
        way = self.presliding.way if self.presliding is not None else 0.0
        for vector, out in zip(many, torque, strict=True):
            machines.required_Nm(self._model, vector, self._x, self._v, self._a, self._period_s, out, way)
        return self._filter.smooth(torque)


def _filter_for(data: Measured) -> MotionFilter:
    """As wide as the noise of what is measured allows."""
    if data.integrated:
        return MotionFilter.for_speed(data.v_m_s[1], data.period_s)
    return MotionFilter.for_position(data.x_m[1], data.period_s)


def _passing(speed: Array, slow: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """(n,): the slow rows of at most so many in a row, in which the speed changes its sign."""
    found = np.zeros_like(slow)
    for first, end in _runs(slow):
        if end - first <= most and first > 0 and end < len(slow) and speed[first - 1] * speed[end] < 0.0:
            found[first:end] = True
    return found


def _runs(rows: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(runs, 2): first of the rows that follow one another, and the one after the last."""
    return np.flatnonzero(np.diff(np.concatenate([[False], rows, [False]]))).reshape(-1, 2)


def _with_surroundings(left_out: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,): the rows left out, and as many on either side of each gap: the longer it is the worse it is bridged."""
    found = left_out.copy()
    for first, end in _runs(left_out):
        found[max(2 * first - end, 0) : 2 * end - first] = True
    return found
