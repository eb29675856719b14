"""Prediction on the measured motion: the torque that it needs, whatever loops made the axis move so."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.ndimage import binary_dilation
from scipy.signal import butter, sosfiltfilt

from hilbench.arrays import Array, runs
from hilbench.diagnosis import machines
from hilbench.diagnosis.coupling import Arm, Motion, by_accelerations, columns, explains, left_unseen, likelier
from hilbench.diagnosis.measured import STANDSTILL_M_S, Measured
from hilbench.diagnosis.noise import NORMAL_95, floor, rms
from hilbench.diagnosis.predictor import Predictor
from hilbench.diagnosis.presliding import Presliding, presliding, shortest
from hilbench.diagnosis.residual_analysis import Condition, of_motion
from hilbench.diagnosis.smooth_motion import evenly_with, frequency_of_sine, harmonics, smoothed
from hilbench.plant.model_file import Machine

#: Speed below which an axis is at rest at least, as a share of its usual highest speed.
_STANDSTILL_SHARE: Final = 0.02
#: Share of the measured acceleration's variance that may be the encoder's noise. By as much an inertia is found too
#: small: noise in a regressor pulls its coefficient to zero.
_NOISE_SHARE: Final = 1e-3
#: Share of the measured acceleration's power in the octave above a frequency that may be the encoder's noise for a
#: resonance to be looked for there, and the ratio of one that is tried to the next. Noise that the torque has no part
#: of is as if an inertia were lacking at these frequencies, which is what a shaft that twists makes.
_KNOWN_SHARE, _NEXT = 0.1, 1.15
#: Share of a torque's rms to which a right model has it, as white noise.
_KNOWN_TORQUE: Final = 0.01
#: Corners of the filter, Hz: highest, lowest, and the ratio of one that is tried to the next.
_HIGHEST_HZ, _LOWEST_HZ, _FINER = 60.0, 5.0, 0.9
#: How far the filter smears what happens at standstill, in periods of its corner; time, in the same, within which an
#: axis that reverses passes through standstill: what is predicted passes it as fast, in the same filter. The same
#: where it is known how friction turns over.
_REACH, _PASSES, _TURNS_OVER = 1.5, 0.5, 4.0
#: Band of the motion from which a torque is predicted, in corners of the filter that the torque passes: up to the first
#: nothing is lost, for what passes two filters is not what passes one; beyond the second nothing is left.
_WIDER: Final = (1.5, 2.5)
#: Displacements over which friction may turn as well on one steady sine, as shares of the one that is known; and as
#: shares of the least one that is looked for, where none was found.
_OTHER_LENGTHS, _UNSEEN_LENGTHS = (0.25, 0.5, 2.0, 4.0), (0.1, 0.25, 0.5, 1.0)
#: Share of the displacement by which friction that turns over as bristles do is another than one that is a spring.
_TURNS_OTHERWISE: Final = 0.5
#: How much longer than the shortest that is looked for one may be that is not found.
_UNSEEN: Final = 3.0
#: Harmonics of one steady sine of which what is left says how much may be left of the first.
_HARMONICS: Final = 5.5
#: Share of the inertia to which a right model may have it, one standard deviation.
_INERTIA_KNOWN: Final = 0.02
#: Corner as a share of the Nyquist frequency, and rows per period of it.
_OF_NYQUIST, _ROWS_PER_PERIOD = 0.8, 4.0
#: Least rows per period of it of the grid on which torques are worked out: friction that reverses between two rows must
#: not fold back into the band. Order of the filter, and periods of its corner by which values go on beyond their ends.
_FINE, _ORDER, _BEYOND = 16.0, 4, 3.0
#: Rows that a step between two held values takes at most where rows were put onto another grid, and how many such steps
#: say what a count is.
_ROWS_OF_A_COUNT, _COUNTS = 2, 20
#: The lowest corner beside another axis, Hz, and the ratio of one that is tried to the next.
_LOWEST_COUPLED_HZ, _NEXT_COUPLED = 2.0, 0.8


@dataclass(frozen=True)
class MotionFilter:
    """A zero-phase low pass for everything that is compared, so that nothing is shifted in time.

    As in identification of robots by inverse dynamics (Gautier, Janot): position is differentiated after it.
    """

    corner_hz: float
    period_s: float
    #: Above it the gain falls as the noise of the acceleration rises, with this power of the frequency, so that it is
    #: as loud everywhere: what is noise at a frequency counts for little there.
    flat_to_Hz: float = float("inf")
    power: int = 2

    def smooth(self, values: Array) -> Array:
        """Values (…, n), filtered forward and backward."""
        return np.asarray(sosfiltfilt(self._sections, values))

    @cached_property
    def _sections(self) -> Array:
        return np.asarray(butter(_ORDER, self.corner_hz * 2.0 * self.period_s, output="sos"))

    @property
    def every(self) -> int:
        """Rows per row that is compared."""
        return max(1, round(1.0 / (_ROWS_PER_PERIOD * self.corner_hz) / self.period_s))

    @property
    def whole(self) -> int:
        """How many times finer than the rows the grid is on which torques are worked out."""
        return max(1, round(_FINE * self.corner_hz * self.period_s))

    def compared(self, values: Array, whole: int = 1) -> Array:
        """Values (…, (n - 1)·whole + 1) on a grid `whole` times finer than the rows, filtered, every so many rows of
        them. Of a band-limited signal it is the same from every grid."""
        step = self.every * whole
        count = -(-values.shape[-1] // step)
        beyond = int(np.ceil(_BEYOND / (self.corner_hz * self.period_s * self.every)))
        beyond = min(beyond, (values.shape[-1] - 1) // step)
        length = next_fast_len(count + 2 * beyond, real=True)
        ends = [(0, 0)] * (values.ndim - 1)
        padded = np.pad(values, [*ends, (beyond * step, beyond * step)], mode="reflect")
        padded = np.pad(padded, [*ends, (0, max(length * step - padded.shape[-1], 0))], mode="edge")
        spectrum = rfft(padded[..., : length * step])[..., : length // 2 + 1] / step
        frequency_Hz = np.arange(length // 2 + 1) / (length * self.every * self.period_s)
        spectrum *= self._gain(frequency_Hz)
        return np.asarray(irfft(spectrum, length)[..., beyond : beyond + count])

    def _gain(self, frequency_Hz: Array) -> Array:
        low_pass = 1.0 / (1.0 + (frequency_Hz / self.corner_hz) ** (2 * _ORDER))
        return np.asarray(low_pass / np.sqrt(1.0 + (frequency_Hz / self.flat_to_Hz) ** (2 * self.power)))

    @property
    def noise_gain(self) -> float:
        """Share of the standard deviation of white noise that passes."""
        return float(np.sqrt(np.mean(self._gain(np.linspace(0.0, 0.5 / self.period_s, 500)) ** 2)))

    def driving(self, position: Array) -> Motion:
        """The motion of a position (n,), on the finer grid, from which what passes this filter is predicted."""
        band_Hz = (_WIDER[0] * self.corner_hz, _WIDER[1] * self.corner_hz)
        return Motion(*smoothed(position, self.period_s, self.whole, band_Hz, 2))

    def differentiated(self, values: Array, order: int) -> Array:
        """Derivative of values (n,) of an order, smoothed, per s to its power."""
        found = self.smooth(values)
        for _ in range(order):
            found = np.gradient(found, self.period_s)
        return found

    @classmethod
    def widest(cls, measured: Array, period_s: float, order: int = 2) -> MotionFilter:
        """Find the widest filter with which the noise of a measured position (n,), order 2, or a speed, order 1, hardly
        shows in the acceleration."""
        noise, corner = position_noise(measured), min(_HIGHEST_HZ, _OF_NYQUIST * 0.5 / period_s)
        impulse = np.zeros(2 * round(2.0 / _LOWEST_HZ / period_s) + 1)
        impulse[len(impulse) // 2] = 1.0
        while True:
            found = cls(corner, period_s)
            carried = noise**2 * float(np.sum(found.differentiated(impulse, order) ** 2))
            if carried <= _NOISE_SHARE * float(np.var(found.differentiated(measured, order))) or corner <= _LOWEST_HZ:
                return found
            corner = max(_FINER * corner, _LOWEST_HZ)


def position_noise(position: Array) -> float:
    """Standard deviation of the noise of a measured position or speed (n,): white, or counts, whichever is more."""
    steps = np.abs(np.diff(position))
    moves = steps > 1e-9 * max(float(np.ptp(position)), 1e-300)
    count = max(float(np.min(steps[moves])), _count_between_rows(position, moves)) if np.any(moves) else 0.0
    return max(floor(position), count / float(np.sqrt(12.0)))


def known_to_Hz(measured: Array, period_s: float, order: int) -> float:
    """Frequency up to which in the octave above each the noise of a position (n,), order 2, or a speed, order 1, is a
    small share of what its acceleration has there."""
    differences = np.diff(measured, order)
    window, f = np.hanning(len(differences)), np.fft.rfftfreq(len(differences), period_s)
    power = np.cumsum(np.abs(np.fft.rfft(differences * window)) ** 2)
    noise = (2.0 * np.sin(np.pi * f * period_s)) ** (2 * order) * position_noise(measured) ** 2 * np.sum(window**2)
    noise, low = np.cumsum(noise), _LOWEST_HZ
    while low < f[-1]:
        first, last = np.searchsorted(f, (low, min(2.0 * low, f[-1])))
        if noise[last] - noise[first] > _KNOWN_SHARE * (power[last] - power[first]):
            break
        low *= _NEXT
    return low


def _count_between_rows(position: Array, moves: NDArray[np.bool_]) -> float:
    """The least step of a position (n,) from one held value to the next, hardly a row apart; 0 where few are.

    Rows that were put onto another grid have parts of a count between them, and held values are whole counts apart.
    moves (n - 1,): whether the position does, from each row to the next.
    """
    first, end = runs(moves).T
    short = runs(moves)[(end - first <= _ROWS_OF_A_COUNT) & (first > 0) & (end < len(moves))]
    return float(np.min(np.abs(position[short[:, 1]] - position[short[:, 0]]))) if len(short) >= _COUNTS else 0.0


class OnMeasuredMotion(Predictor):
    """The torque that the measured motion of a lone axis needs; no control loop has to be known.

    Motion and torque pass the same filter, which is as wide as the encoder's noise allows.
    """

    def __init__(
        self,
        model: Machine,
        data: Measured,
        wider: OnMeasuredMotion | None = None,
        arm: Arm | None = None,
        corner_hz: float | None = None,
    ) -> None:
        """`wider`: one of which it is known how friction turns over; `corner_hz`: by default as high as the position's
        noise allows.

        arm: how the axis is coupled with the other one that the recording has; None: it is not.
        """
        self._model, self._data = model, data
        self.arm = arm
        self.names, self.exact = ("tau1_Nm",), False
        self._period_s = data.period_s
        if wider is None:
            measured, order = _measured_motion(data)
            band = MotionFilter.widest(measured, data.period_s, order)
        else:
            band = wider._filter
        if corner_hz is not None:
            band = replace(band, corner_hz=corner_hz)
        self._filter: MotionFilter = _weighed(band, data, machines.Nm_per_acceleration(model, 1))
        self._x = self._filter.smooth(data.x_m[1])
        self._v = np.gradient(self._x, data.period_s)
        self._a = np.gradient(self._v, data.period_s)
        self.every, self._whole = self._filter.every, self._filter.whole
        # With all that the filter takes, so that what is predicted passes one filter, as what is measured does.
        self._driving = self._filter.driving(data.x_m[1])
        self._shortest = shortest(self._driving, self.corner_hz)
        self.tolerances = np.zeros(1)
        self.measured = self._filter.compared(data.tau_Nm[1])[None]
        self._noise_Nm = floor(data.tau_Nm[1]) * self._filter.noise_gain
        self._memory_s: float = 0.0 if wider is None else wider._memory_s
        self._upright = self._driving.angle
        self._coupled = self._couplings()
        self.presliding: Presliding | None = self._presliding() if wider is None else wider.presliding
        self.rows = self._rows()
        self._t_s = data.t_s

    @property
    def corner_hz(self) -> float:
        """Corner frequency of the filter."""
        return self._filter.corner_hz

    @cached_property
    def known_to_Hz(self) -> float:
        """Frequency up to which the motion is known well enough to tell an inertia that twists from its noise."""
        measured, order = _measured_motion(self._data)
        return known_to_Hz(measured, self._period_s, order)

    @property
    def turns(self) -> float:
        """Turns of the motor between the ends of the motion."""
        return float(np.ptp(self._x)) * self._model.motor_rad_per_unit(1) / (2.0 * np.pi)

    def below(self, corner_hz: float) -> OnMeasuredMotion:
        """Prediction with a lower corner."""
        return OnMeasuredMotion(self._model, self._data, self, self.arm, corner_hz)

    @property
    def narrower(self) -> OnMeasuredMotion | None:
        """Prediction with half the corner; None with a coupled axis where that is lower than any that is tried."""
        if self.arm is not None and 0.5 * self.corner_hz < _LOWEST_COUPLED_HZ:
            return None
        return self.below(0.5 * self.corner_hz)

    def settled_beside(self, torques: Array, memory_s: float) -> OnMeasuredMotion:
        """Copy whose rows count once the oscillation of before the recording is forgotten, and whose displacement over
        which friction turns over is looked for again beside torques (J, n of the prediction), of which any multiple
        may be there."""
        result = copy(self)
        result._memory_s = memory_s
        result.presliding = result._presliding(torques)
        result.rows = result._rows()
        return result

    @property
    def direction(self) -> Array:
        """(n rows of the recording,): sign of the speed."""
        return np.sign(self._v)

    @property
    def acceleration(self) -> Array:
        """(n rows of the recording,): of the motor or web, in the unit of the position per s²."""
        return self._driving.acceleration[:: self._whole]

    def compared(self, values: Array) -> Array:
        """Values (…, n rows of the recording) as they are compared (…, n of the prediction)."""
        return self._filter.compared(values)

    def _compared(self, fine: Array) -> Array:
        """Values (…, fine) as they are compared (…, n of the prediction)."""
        return self._filter.compared(fine, self._whole)

    def _presliding(self, beside: Array | None = None) -> Presliding | None:
        """Presliding at reversals; fitted with other torques `beside` (J, n)."""
        rows = self._moving(_TURNS_OVER)[:: self.every]
        others = [*self._coupled.values(), *([] if beside is None else beside)]
        return presliding(
            self._driving,
            self.measured[0],
            self._compared,
            rows,
            self._shortest,
            others,
            may_play=any(effect.id == "backlash" for effect in machines.vocabulary(self._model)),
        )

    def _couplings(self) -> dict[str, Array]:
        """Coupling torques (n of the prediction,) by name, of which any multiple may be there."""
        joints = self._joints()
        if joints is None or self.arm is None:
            return {}
        own, other = joints
        if self.arm is Arm.CARRIED:
            self._upright = self._driving.angle + self._model.gear_ratio(1) * other.angle
        return {name: self._compared(column) for name, column in columns(self.arm, own, other).items()}

    def _joints(self) -> tuple[Motion, Motion] | None:
        """Motion of this joint and of the other one in the recording; None without another."""
        if self._data.other_rad is None:
            return None
        ratio, driving = self._model.gear_ratio(1), self._driving
        own = Motion(driving.angle / ratio, driving.speed / ratio, driving.acceleration / ratio)
        return own, self._filter.driving(self._data.other_rad)

    def by_accelerations(self, parameters: Array) -> tuple[Array, Array]:
        """(2, couplings, n) and (2, n): by how much the torque per unit of each coupling, and the torque with these
        parameters (P,), changes with the acceleration of this joint and of the other one; none without another."""
        joints = self._joints()
        if joints is None or self.arm is None:
            return np.empty((0, 0, len(self.rows))), np.empty((0, len(self.rows)))
        per_unit = by_accelerations(self.arm, *joints)[..., :: self.every * self._whole]
        torque = np.einsum("j,kjn->kn", list(self.coupled_by(parameters).values()), per_unit)
        torque[0] += self._model.gear_ratio(1) * machines.Nm_per_acceleration(self._model, 1)
        return per_unit, torque

    def left_unseen(self) -> float:
        """Share of the torque's rms that a regression by the simple effects, its gravity and the couplings leaves,
        stretches predicted from one another."""
        angle, speed = self._upright / self._model.gear_ratio(1), self._driving.speed
        turns = np.tanh(speed / self._slow)
        simple = np.array([self._driving.acceleration, speed, turns, np.sin(angle), np.cos(angle), np.ones(len(angle))])
        explaining = np.array([*self._compared(simple), *self._coupled.values()])
        return left_unseen(self.measured[0, self.rows], explaining[:, self.rows])

    @property
    def _slow(self) -> float:
        """Speed below which the axis is at standstill."""
        return max(STANDSTILL_M_S, _STANDSTILL_SHARE * float(np.quantile(np.abs(self._v), 0.99)))

    def _rows(self) -> NDArray[np.bool_]:
        """(n,): those that count, of those that are compared."""
        return self._moving(_PASSES if self.presliding is None else _TURNS_OVER)[:: self.every]

    def _moving(self, passes: float) -> NDArray[np.bool_]:
        """(n,): where the axis moves, and no standstill, gap or end of the recording is within reach of the filter.

        passes: periods of the corner within which a reversal is no standstill.
        """
        at_standstill = np.abs(self._v) < self._slow
        at_standstill &= ~_passing(self._v, at_standstill, round(passes / self.corner_hz / self._period_s))
        unknown = ~self._data.usable()
        at_standstill |= _with_surroundings(unknown)
        at_standstill[[0, -1]] = unknown[0] = True
        for _, end in runs(unknown):
            at_standstill[end : end + round(self._memory_s / self._period_s)] = True
        return ~binary_dilation(at_standstill, iterations=round(_REACH / self.corner_hz / self._period_s))

    @property
    def starts(self) -> int:
        """Number of starts of the recording: after each gap once more."""
        unknown = ~self._data.usable()
        unknown[0] = True
        return len(runs(unknown))

    def floor(self, signal: int) -> float:
        """Noise of the measured torque above the band in which motion is known, carried into the band as white."""
        return self._noise_Nm

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time and motion. Before friction slides, and within a play, it depends on the displacement since the last
        reversal."""
        step, unit = slice(None, None, self.every), self._model.position_unit
        turns = np.concatenate([[0], np.flatnonzero(np.diff(np.sign(self._v))) + 1, [len(self._v)]])
        since = self._x - np.repeat(self._x[turns[:-1]], np.diff(turns))  # signed by the direction
        return [
            *of_motion(self._t_s[step], 1, unit, self._v[step], self._a[step]),
            Condition("position of axis 1", unit, self._x[step], spectral=True),
            Condition("travel since the last reversal of axis 1", unit, since[step]),
        ]

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, 1, n): torque by the laws, filtered as the measurement is, and what the couplings explain of
        what these leave."""
        required = self._required(parameters)[:, None]
        if not self._coupled:
            return required
        return self.measured - self._beside(self.measured - required)

    def _beside(self, values: Array) -> Array:
        """Values (…, n of the prediction) without what the couplings explain of them in the rows that count."""
        return values - self._coupled_in(values) @ self.couplings if self._coupled else values

    def _coupled_in(self, values: Array) -> Array:
        """Least-squares amounts (…, J) of each coupling in values (…, n of the prediction)."""
        return np.asarray(values[..., self.rows] @ np.linalg.pinv(self.couplings[:, self.rows]))

    @property
    def couplings(self) -> Array:
        """(J, n of the prediction): torque per unit of each coupling with the other axis."""
        return np.array(list(self._coupled.values()))

    def coupled_by(self, parameters: Array) -> dict[str, float]:
        """Least-squares amount of each coupling in what the laws leave with these parameters (P,)."""
        left = self.measured[0] - self._required(parameters)[0]
        return dict(zip(self._coupled, self._coupled_in(left).tolist(), strict=True))

    @cached_property
    def sine_Hz(self) -> float | None:
        """The frequency of the one steady sine by which the axis goes to and fro; None of any other motion."""
        return None if self.arm is not None else frequency_of_sine(self._v[:: self.every], self.every * self._period_s)

    def repeating(self, frequency_Hz: float) -> Array:
        """(waves, n): all of a torque that repeats itself so often, up to the filter's corner, or to a harmonic beyond
        which what is left is no measure of what is left of the first."""
        return harmonics(frequency_Hz, min(self.corner_hz, _HARMONICS * frequency_Hz), self._t_s[:: self.every])

    def alike_on_one_sine(self, parameters: Array) -> Array:
        """(shapes, 1, n): what on one steady sine a torque may be in the place of a law beside friction and inertia:
        what goes with the position, and friction that turns over another displacement, with these parameters (P,)."""
        known, shortest = self.presliding, self._shortest
        lengths = (
            [share * known.presliding_travel for share in _OTHER_LENGTHS]
            if known
            else [share * shortest for share in _UNSEEN_LENGTHS]
        )
        turning_Nm = [self._turning_over(presliding_travel, parameters) for presliding_travel in lengths]
        return np.concatenate([self._compared(evenly_with(self._driving.angle)), turning_Nm])[:, None]

    @property
    def uncoupled(self) -> OnMeasuredMotion:
        """Prediction by the same laws on the same rows, without coupling torques."""
        result = copy(self)
        result._coupled = {}
        return result

    def doubts(self, parameters: Array) -> Array:
        """(shapes, 1, n): a rigid inertia that the model has not, a torque that is read some time within a row, and how
        friction turns over."""
        late = 0.5 * np.gradient(self._required(parameters)[0]) / self.every
        others = self._beside(late[None, None])
        return np.concatenate([_INERTIA_KNOWN * self.of_inertia, others, self.doubt_of_turning(parameters)])

    @property
    def of_inertia(self) -> Array:
        """(1, 1, n): the torque of the model's whole inertia, which may be a guess."""
        inertia_Nm = machines.Nm_per_acceleration(self._model, 1) * self._compared(self._driving.acceleration)
        return self._beside(inertia_Nm[None, None])

    def doubt_of_turning(self, parameters: Array) -> Array:
        """(1, 1, n): of these, friction with a presliding displacement too short to be seen, or at its upper bound."""
        if self.presliding is None:
            presliding_travel = _UNSEEN * self._shortest
        else:
            known = self.presliding
            off = max((known.ci95[1] - known.presliding_travel) / NORMAL_95, _TURNS_OTHERWISE * known.presliding_travel)
            presliding_travel = known.presliding_travel + off
        return self._beside(self._turning_over(presliding_travel, parameters)[None, None])

    def _turning_over(self, presliding_travel: float, parameters: Array) -> Array:
        """(n,): change of the torque with these parameters (P,) where friction turns over this displacement."""
        other = copy(self)
        other.presliding = Presliding(presliding_travel, (presliding_travel, presliding_travel))
        return np.asarray(other._required(parameters)[0] - self._required(parameters)[0])

    def _required(self, parameters: Array) -> Array:
        """(B, P) to (B, n of the prediction)."""
        many = np.atleast_2d(parameters)
        torque = np.empty((len(many), len(self._driving.angle)))
        for vector, out in zip(many, torque, strict=True):
            self._write_required(vector, self._driving.angle, out)
            if self.arm is Arm.CARRIED:
                out += self._gravity_moved(vector)
        return self._compared(torque)

    def _write_required(self, vector: Array, x: Array, out: Array) -> None:
        presliding_travel = self.presliding.presliding_travel if self.presliding is not None else 0.0
        driving = self._driving
        machines.of_kind(self._model).required_torque_Nm(
            vector, x, driving.speed, driving.acceleration, self._period_s / self._whole, out, presliding_travel
        )

    def _gravity_moved(self, vector: Array) -> Array:
        """(n,): by how much the torque of what is unbalanced is another because it goes with the angle of both axes."""
        balanced = machines.without_unbalance(vector)
        moved = np.zeros(len(self._driving.angle))
        if np.array_equal(balanced, vector):
            return moved
        for x, sign in ((self._upright, 1.0), (self._driving.angle, -1.0)):
            for parameters, of in ((vector, sign), (balanced, -sign)):
                out = np.empty(len(x))
                self._write_required(parameters, x, out)
                moved += of * out
        return moved


def coupled_motion(model: Machine, data: Measured) -> OnMeasuredMotion | None:
    """The prediction beside the other axis that the recording has; None without one, or where its motion does not
    explain much.

    Gravity and inertia nearly make up for one another in an arm that oscillates freely, so that noise
    that hardly shows in an acceleration shows in them: the corner is that with which the stretches of the recording
    predict one another best; what carries what is the same with every corner.
    """
    if data.other_rad is None:
        return None
    wide = OnMeasuredMotion(model, data)
    corners = [wide.corner_hz]
    while corners[-1] * _NEXT_COUPLED >= _LOWEST_COUPLED_HZ:
        corners.append(corners[-1] * _NEXT_COUPLED)
    tried = {arm: [OnMeasuredMotion(model, data, wide, arm, corner) for corner in corners] for arm in Arm}
    left = {arm: [motion.left_unseen() for motion in tried[arm]] for arm in Arm}
    arm = likelier(left)
    best = tried[arm][int(np.argmin(left[arm]))]
    alone = OnMeasuredMotion(model, data, wide, None, best.corner_hz)
    if not explains(best.left_unseen(), alone.left_unseen()):
        return None
    return OnMeasuredMotion(model, data, None, best.arm, best.corner_hz)


def _measured_motion(data: Measured) -> tuple[Array, int]:
    """Position (n,) or speed of the axis, whichever was measured, and which derivative its acceleration is."""
    return (data.v_m_s[1], 1) if data.integrated else (data.x_m[1], 2)


def _weighed(band: MotionFilter, data: Measured, inertia: float) -> MotionFilter:
    """Filter in which the noise of the acceleration's torque is nowhere louder than what is known of the torque.

    inertia: torque per acceleration.
    """
    measured, power = _measured_motion(data)
    noise = position_noise(measured)
    known_Nm = float(np.hypot(floor(data.tau_Nm[1]), _KNOWN_TORQUE * rms(data.tau_Nm[1])))
    flat_to_Hz = (known_Nm / max(inertia * noise, 1e-300)) ** (1.0 / power) / (2.0 * np.pi)
    return replace(band, flat_to_Hz=flat_to_Hz, power=power)


def _passing(speed: Array, slow: NDArray[np.bool_], most: int) -> NDArray[np.bool_]:
    """(n,): the slow rows of at most so many in a row, in which the speed changes its sign."""
    found = np.zeros_like(slow)
    for first, end in runs(slow):
        if end - first <= most and first > 0 and end < len(slow) and speed[first - 1] * speed[end] < 0.0:
            found[first:end] = True
    return found


def _with_surroundings(left_out: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(n,): the rows left out, and as many on either side of each gap: the longer it is the worse it is bridged."""
    found = left_out.copy()
    for first, end in runs(left_out):
        found[max(2 * first - end, 0) : 2 * end - first] = True
    return found
