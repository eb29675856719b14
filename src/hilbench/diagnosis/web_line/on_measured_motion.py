"""Prediction of a web line on the measured motion of its rollers: what their torques must be, whatever made them move.

Neither commands nor control loops are needed. The strain of the span follows from what the web travelled at both
rollers, each torque from the balance of its roller: `hilbench.plant.web_line.line_inverse`. Both measured and predicted
torque pass the same filter, of a band in which the noise of the acceleration is small beside that of the torque. What
an effect changes is worked out on a calmer motion still: noise in a regressor is correlated with what is left of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from hilbench.arrays import Array
from hilbench.diagnosis.loop_check import DriveRecord, Loop, loop_of
from hilbench.diagnosis.machines import Nm_per_acceleration
from hilbench.diagnosis.measured import STANDSTILL_M_S, Measured
from hilbench.diagnosis.noise import floor
from hilbench.diagnosis.predictor import Predictor
from hilbench.diagnosis.residual_analysis import Condition, of_motion
from hilbench.diagnosis.smooth_motion import Thinning, low_passed, smoothed
from hilbench.diagnosis.web_line.free_run import of_line, remembered_m
from hilbench.diagnosis.web_measurements import tension_names
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_inverse import RequiredTorques, required_torques
from hilbench.plant.web_line.parameters import ModelParameters

#: How long before and after a standstill rows are left out, s.
_NEAR_S: Final = 0.05
#: Band of the motion that residuals are looked at against, Hz, at most.
_CALM_HZ: Final = 6.0
#: Longest period of the grid on which torques are worked out, s: ripple that is faster than the band must not fold
#: back into it.
_FINE_S: Final = 0.001
#: Noise of the acceleration's torque at the end of the band, as a share of the torque's own (densities of power); and
#: of the motion from which it follows what an effect changes. Noise there is shifted by a delay until it cancels the
#: torque's by chance, which no price of a parameter covers.
_NOISE_SHARE: Final = 0.15
_CALM_SHARE: Final = 0.01
#: Lowest and highest end of the band, and lowest of the calm one, Hz.
_LOWEST_HZ: Final = 5.0
_HIGHEST_HZ: Final = 60.0
_CALMEST_HZ: Final = 1.5
#: How far beyond the band motion is taken, and up to which share of half the sampling rate.
_WIDER: Final = 1.3
_OF_NYQUIST: Final = 0.95
#: Web transports (lengths of the span) after which the strain at the start is forgotten.
_TRANSPORTS: Final = 4.0
#: Cycle in which commands change at most, s, and the share of the inertia that torques read in step with it can't show.
_COMMANDS_S: Final = 0.002
_IN_STEP: Final = 0.007
#: Time within a sample of a drive at which its torque may have been read, s.
_READ_S: Final = 0.0005


class LineOnMeasuredMotion(Predictor):
    """Driven rollers and the spans between them, on measured motion.

    Rows are read at one instant for all channels, but not always when they say: what all axes have in common then has
    the noise of that time, what they differ by has not. So mean motion and differences from it are smoothed each for
    itself, the acceleration of the mean from positions or speeds, whichever show it better.

    Without all positions the strain is not known: a travel that is added up from speeds drifts by more than the web is
    stretched. What is left is the sum of the torques, in which the tensions between the rollers are not.
    """

    def __init__(self, model: ModelParameters, data: Measured) -> None:
        self._model, self._data = model, data
        self._torques = sorted(data.tau_Nm)
        self.knows_strain = set(data.x_m) >= set(range(1, model.axis_count + 1))
        self._tensions = sorted(data.F_N) if self.knows_strain else []
        torques = [f"tau{axis}_Nm" for axis in self._torques]
        self._mixed = np.eye(len(torques)) if self.knows_strain else np.ones((1, len(torques)))
        if not self.knows_strain:
            torques = [" + ".join(torques)]
        self.names = (*torques, *(tension_names(data.F_N) if self.knows_strain else ()))
        noise = _Noise(model, data)
        thinning = noise.thinning
        self._thinning, self.every = thinning, thinning.every
        self._whole = max(1, round(data.period_s / _FINE_S))
        self._fine_s = data.period_s / self._whole
        nyquist = 0.5 / data.period_s
        band = (min(thinning.highest_Hz, 0.85 * nyquist), min(_WIDER * thinning.highest_Hz, _OF_NYQUIST * nyquist))
        self._band_Hz = band
        self._measured_motion = _motion(data, self._whole, (band, band), noise.mean_by_speed)
        calm = [(min(end, band[0]), min(_WIDER * end, band[1])) for end in noise.calm_ends_Hz]
        self._calm_Hz = min(_CALM_HZ, calm[0][0])
        self._x, self._v, self._a = _motion(data, self._whole, (calm[0], calm[1]), noise.mean_by_speed)
        self._boundary = np.repeat(data.boundary, self._whole, axis=0)[: len(self._x)]
        rows = np.array([data.tau_Nm[axis] for axis in self._torques] + [data.F_N[span] for span in self._tensions])
        self._torque_floors, tension_floors = noise.floors()
        mixed = np.sqrt(self._mixed**2 @ np.square(self._torque_floors))
        self._floors = np.concatenate([mixed, tension_floors[: len(self._tensions)]])
        self.tolerances = np.zeros(len(self.names))
        self.rows = self._usable()
        self._sampling = self._in_step()
        measured, cycle_s = thinning.apply(rows), min(data.period_s, _COMMANDS_S)
        for k, axis in enumerate(self._torques):
            measured[k] -= sampling_bias_Nm(model, axis, cycle_s) * self._at_rows(self._a[:, axis - 1])
        self._by_model = self._above_the_calm(lay.pack(model))
        self.measured = self._discounted(self._mix(measured) - self._by_model)

    def _usable(self) -> NDArray[np.bool_]:
        """Rows without standstill, where dry friction is not one law, the time of the first strain, and the ends."""
        data, every = self._data, self.every
        reach_s = self._thinning.reach_s + _NEAR_S
        reach = round(reach_s / self._fine_s)
        slow = np.min(np.abs(self._v), axis=1) < STANDSTILL_M_S
        near = np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5
        travel = cumulative_trapezoid(np.abs(self._v[:, -1]), dx=self._fine_s, initial=0)
        forgotten = remembered_m(self._model, _TRANSPORTS)
        if travel[-1] > 5.0 * forgotten:
            near |= travel < forgotten
        near[:reach] = near[-reach:] = True
        rows = ~near[:: self._whole] & data.usable(reach_s)
        return np.asarray(rows[::every])

    def _above_the_calm(self, parameters: Array) -> Array:
        """(signals, n): what the measured motion needs by parameters (P,) more than its calm part."""
        motions = self._measured_motion, (self._x, self._v, self._a)
        runs = [self._run(parameters[None], motion) for motion in motions]
        return np.asarray((self._signals(runs[0]) - self._signals(runs[1]))[0])

    def quick(self, parameters: Array) -> Array:
        """(signals, n): as of any prediction; what is quick is above the calm motion."""
        return self._discounted(self._above_the_calm(parameters) - self._by_model)

    def _at_rows(self, fine: Array) -> Array:
        return self._thinning.apply(fine, self._whole)

    def _in_step(self) -> list[list[Array]]:
        """Shapes of each torque, in noise floors, that are known only up to a share: it is read in step with the
        drive's cycle (the acceleration), and at some time of a drive's sample (its own rate)."""
        shapes = [
            _IN_STEP * Nm_per_acceleration(self._model, axis) * self._at_rows(self._a[:, axis - 1])
            for axis in self._torques
        ]
        late = self._read_late(self._run(lay.pack(self._model)[None]))
        mixed = [self._mixed @ np.array(rows) for rows in (shapes, late)]
        found = []
        for k in range(len(self._mixed)):
            found.append([np.where(self.rows, rows[k] / self._floors[k], 0.0) for rows in mixed])
        return found

    def _read_late(self, run: RequiredTorques) -> list[Array]:
        """Fall of each torque (n,) where it is read later, by a deviation of that time."""
        rates = np.gradient(run.tau_Nm[0], self._fine_s, axis=0)
        return [_READ_S * self._at_rows(rates[:, axis - 1]) for axis in self._torques]

    def doubts(self, parameters: Array) -> Array:
        """(shapes, signals, n): when torques are read matters to what the model has been extended by as well."""
        runs = self._run(np.array([parameters, lay.pack(self._model)]))
        more = RequiredTorques(*(values[:1] - values[1:] for values in (runs.tau_Nm, runs.F_N, runs.strain)))
        late = self._read_late(more)
        found = np.zeros((len(late), len(self.names), len(self.rows)))
        for k, shape in enumerate(late):
            found[k, : len(self._mixed)] = self._mixed[:, [k]] * shape
        return self._discounted(found)

    def _mix(self, signals: Array) -> Array:
        """(…, torques then tensions, n): of the torques what can be compared."""
        k = len(self._torques)
        if self.knows_strain:
            return signals
        return np.asarray(np.einsum("ij,...jn->...in", self._mixed, signals[..., :k, :]))

    def _discounted(self, signals: Array) -> Array:
        """(…, signals, n) with each shape that is known only to a share made as loud as the noise, (1 + uuᵀ)^-½.

        The noise of a torque that is read in step with the drive's cycle has that shape beside the white one.
        """
        for k, shapes in enumerate(self._sampling):
            for shape in shapes:
                square = float(shape @ shape)
                if square > 0.0:
                    along = signals[..., k, :] @ shape / square
                    signals[..., k, :] -= (1.0 - 1.0 / np.sqrt(1.0 + square)) * along[..., None] * shape
        return signals

    def loops(self) -> list[Loop]:
        """The drives' loops as commands, motion and torques show them; none without commands."""
        data, found = self._data, []
        if not data.commands_m_s.size:
            return []
        needed = self._run(lay.pack(self._model)[None]).tau_Nm[0]
        for k, axis in enumerate(self._torques):
            command, torque = data.commands_m_s[:, axis - 1], data.tau_Nm[axis]
            x, v, a = (values[:, axis - 1] for values in self._measured_motion)
            moved = np.array([self._at_rows(values) for values in (a, v, np.sign(v))])
            beyond = self._thinning.apply(torque) - self._at_rows(needed[:, axis - 1])
            like = np.vstack([moved, np.ones_like(beyond)])[:, self.rows]
            lacking = float(np.linalg.lstsq(like.T, beyond[self.rows], rcond=None)[0][0])
            of_motion = moved, lacking, Nm_per_acceleration(self._model, axis)
            drive = DriveRecord(axis, command, x, v, torque, self._torque_floors[k], *of_motion)
            row_s = self.every * data.period_s
            loop = loop_of(drive, self._model, data.period_s, self._thinning.apply, self.rows, row_s)
            found += [] if loop is None else [loop]
        return found

    def with_force(self, force_N: float, time_s: float) -> LineOnMeasuredMotion:
        """Prediction with a force against the motion of the last roller from a time on."""
        other = copy(self)
        t = np.arange(len(self._x)) * self._fine_s
        against = force_N * np.clip((t + self._fine_s - time_s) / self._fine_s, 0.0, 1.0) * np.sign(self._v[:, -1])
        other._boundary = self._boundary - np.outer(against, [0.0, 1.0])
        return other

    def floor(self, signal: int) -> float:
        """Noise floor of the measured torque in the band, with what the noise of the motion adds."""
        return float(self._floors[signal])

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time, motion of the last axis, tensions and strain rates as the motion makes them, angles."""
        run, last = self._run(parameters[None]), self._model.axis_count
        rows = slice(None, None, self._whole * self.every)
        row_s = self._fine_s * self._whole * self.every
        # What they are looked at against must not have the noise that the residual has.
        band = (self._calm_Hz, 1.5 * self._calm_Hz)
        _, speed, acceleration = smoothed(self._x[rows, -1], row_s, 1, band, 2)
        rates = [smoothed(strain, row_s, 1, band, 1)[1] for strain in run.strain[0, rows].T]
        moved = of_motion(self._data.t_s[:: self.every], last, "m", speed, acceleration)
        return moved + of_line(self._model, run.F_N[0, rows], rates, dict(enumerate(self._x[rows].T, 1)))

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, signals, n), on all cores."""
        return self._discounted(self._signals(self._run(np.atleast_2d(parameters))))

    def _signals(self, run: RequiredTorques) -> Array:
        """(B, signals, n) of the rows that are compared."""
        rows = [run.tau_Nm[..., axis - 1] for axis in self._torques] + [run.F_N[..., k - 1] for k in self._tensions]
        stacked = np.stack(rows, axis=1)
        if self.every == 1 and self._whole > 1:
            # There is no filter before the rows. What is faster than the motion that they can show (a ripple) is
            # answered by motion that nobody has seen, and hardly by the torque: without it a ripple would fold back.
            stacked = low_passed(stacked, self._fine_s, self._band_Hz)
        return self._mix(self._thinning.apply(stacked, self._whole))

    def _run(self, parameters: Array, motion: tuple[Array, Array, Array] | None = None) -> RequiredTorques:
        x_m, v_m_s, a_m_s2 = motion or (self._x, self._v, self._a)
        return required_torques(parameters, self._model, x_m, v_m_s, a_m_s2, self._boundary, self._fine_s)


class _Noise:
    """Noise of motion and torques, and the band that follows from it."""

    def __init__(self, model: ModelParameters, data: Measured) -> None:
        self._model, self._data = model, data
        self._torque_Nm = {axis: floor(tau) for axis, tau in data.tau_Nm.items()}
        self._axes = range(1, model.axis_count + 1)
        self._per_acceleration = max(Nm_per_acceleration(model, axis) for axis in self._axes)
        options: dict[bool, float] = {}
        if set(data.x_m) >= set(self._axes):
            options[False] = floor(_mean_of(data.x_m))
        if set(data.v_m_s) >= set(self._axes):
            options[True] = floor(_mean_of(data.v_m_s))
        if not options:  # some of each
            options[False] = max(floor(values) for values in data.x_m.values())
        self._difference_noise, self._difference_by_speed = self._difference()
        ends = {by_speed: self._band_Hz(by_speed, noise) for by_speed, noise in options.items()}
        self.mean_by_speed = max(ends, key=lambda by_speed: ends[by_speed])
        self._mean_noise = options[self.mean_by_speed]
        self.thinning = self._thinning(float(np.clip(ends[self.mean_by_speed], _LOWEST_HZ, _HIGHEST_HZ)))
        calm = self._ends_Hz(self.mean_by_speed, self._mean_noise, _CALM_SHARE)
        self.calm_ends_Hz = [float(np.clip(end, _CALMEST_HZ, _HIGHEST_HZ)) for end in calm]

    def _difference(self) -> tuple[float, bool]:
        """Noise of half the difference of two positions, m, or of the speeds, m/s, and True if it is the speeds'."""
        data = self._data
        if set(data.x_m) >= set(self._axes):
            return 0.5 * max(floor(data.x_m[axis] - data.x_m[axis + 1]) for axis in self._axes[:-1]), False
        speeds = [floor(values) for axis, values in data.v_m_s.items() if axis not in data.x_m]
        return 0.5 * float(np.linalg.norm(speeds)), True

    def _band_Hz(self, by_speed: bool, noise: float) -> float:
        """Frequency at which the noise of the acceleration's torque has a given share of that of the torque."""
        mean, difference = self._ends_Hz(by_speed, noise, _NOISE_SHARE)
        return float((mean**-4.0 + difference**-4.0) ** -0.25)

    def _ends_Hz(self, by_speed: bool, noise: float, share: float) -> tuple[float, float]:
        """Band ends, Hz, of the mean motion and of the difference alone."""

        def end_Hz(noise: float, power: float) -> float:
            ratio = np.sqrt(share) * max(self._torque_Nm.values()) / max(noise * self._per_acceleration, 1e-300)
            return float(ratio ** (1.0 / power) / (2.0 * np.pi))

        mean = end_Hz(noise, 1.0 if by_speed else 2.0)
        return mean, end_Hz(self._difference_noise, 1.0 if self._difference_by_speed else 2.0)

    def _thinning(self, end_Hz: float) -> Thinning:
        thinning = Thinning(max(1, round(0.5 / (end_Hz * self._data.period_s))), self._data.period_s)
        if thinning.highest_Hz > 0.9 * 0.5 / self._data.period_s:
            return Thinning(1, self._data.period_s)
        return thinning

    def floors(self) -> tuple[Array, Array]:
        """Noise floors of the decimated torques, and of the tensions."""
        data, model, share = self._data, self._model, self.thinning.noise_share
        power = 2 if self.mean_by_speed else 4
        end = 2.0 * np.pi * self.thinning.corner_Hz
        # The mean of (2πf)^power up to the end of the band.
        mean = self._mean_noise * np.sqrt(end**power / (power + 1.0))
        power = 2 if self._difference_by_speed else 4
        acceleration = np.hypot(mean, self._difference_noise * np.sqrt(end**power / (power + 1.0)))
        # Of the tension before the first roller, of each span, and behind the last: N/m of a position's noise.
        stiffness = np.zeros(len(self._axes) + 1)
        if not self._difference_by_speed and model.web is not None:
            spans = range(1, model.span_count + 1)
            stiffness[1:-1] = [model.stiffness_N(span) / model.span_length_m(span) for span in spans]
        position = float(np.sqrt(2.0)) * self._difference_noise
        found = []
        for axis, torque in sorted(self._torque_Nm.items()):
            before, behind = stiffness[axis - 1 : axis + 1]
            web = position * float(np.sqrt(before**2 + behind**2 + (before + behind) ** 2))
            web /= model.motor_rad_per_m(axis)
            found.append(
                share * float(np.sqrt(torque**2 + web**2 + (Nm_per_acceleration(model, axis) * acceleration) ** 2))
            )
        tensions = [
            share * float(np.hypot(floor(data.F_N[span]), np.sqrt(2.0) * position * stiffness[span]))
            for span in sorted(data.F_N)
        ]
        return np.array(found), np.array(tensions)


def sampling_bias_Nm(model: ModelParameters, axis: int, cycle_s: float) -> float:
    """Bias of a torque that is read at the end of each cycle against its mean, N·m per m/s² of the axis.

    In a ramp the command steps once a cycle while the speed grows steadily: the torque jumps and falls within it, and
    one that is read always at its end, just before the next command, is the least of it.
    """
    drives = model.drives
    if drives is None:
        return 0.0
    sample_s, lag_s = drives.sample_time_s, per_item(drives.current_loop_time_constant_s, axis)
    steps = max(1, round(cycle_s / sample_s))
    decay = float(np.exp(-sample_s / lag_s)) if lag_s > 0.0 else 0.0
    level = -np.arange(steps)[::-1] * sample_s  # of the speed error, latest first
    weight = (1.0 - decay) * decay ** np.arange(steps) / (1.0 - decay**steps)
    kp = per_item(drives.velocity_kp_Nm_s_per_rad, axis)
    return kp * model.motor_rad_per_m(axis) * float(weight @ level - np.mean(level))


def _mean_of(values: Mapping[int, Array]) -> Array:
    """(n,): the mean of what axes have."""
    return np.asarray(sum(values.values()) / len(values))


def _motion(
    data: Measured, whole: int, bands_Hz: tuple[tuple[float, float], tuple[float, float]], mean_by_speed: bool
) -> tuple[Array, Array, Array]:
    """Position, speed and acceleration (n, axes) on the fine grid; without all positions that of all is their mean.

    bands_Hz: of the mean motion and of what each axis differs from it by. What speeds that are added up differ by is a
    drift, which would be a tension.
    """
    band_Hz, apart_Hz = bands_Hz
    axes = sorted({*data.x_m, *data.v_m_s})
    travel = {
        axis: data.x_m[axis]
        if axis in data.x_m
        else cumulative_trapezoid(data.v_m_s[axis], dx=data.period_s, initial=0)
        for axis in axes
    }
    mean = _mean_of(travel)
    x, v, a = smoothed(mean, data.period_s, whole, band_Hz, 2)
    if mean_by_speed:
        v, a = smoothed(_mean_of(data.v_m_s), data.period_s, whole, band_Hz, 1)
    all_known = set(data.x_m) >= set(axes)
    apart = [travel[axis] - mean if all_known else np.zeros_like(mean) for axis in axes]
    moved = [smoothed(each, data.period_s, whole, apart_Hz, 2) for each in apart]

    def of_all(common: Array, order: int) -> Array:
        return np.column_stack([common + each[order] for each in moved])

    return of_all(x, 0), of_all(v, 1), of_all(a, 2)
