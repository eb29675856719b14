"""Check of the drives' loops against the model, from command, motion and torque of each drive.

A velocity loop is known from these three alone, whatever hangs on its shaft: torque = lag(kp·e + ki·∫e), e the speed
that was commanded less the one that was measured. Gains by linear least squares, the lag of the current loop, in which
the torque is not linear, by search.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from hilbench.arrays import Array
from hilbench.diagnosis.noise import NORMAL_95
from hilbench.diagnosis.smooth_motion import without_slow
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import DriveParameters, per_item
from hilbench.plant.web_line.parameters import ModelParameters

#: Lags that are tried, s, and how much closer around the best.
_LAGS_S: Final = np.arange(0.0, 0.0101, 0.001)
_CLOSER_S: Final = np.linspace(-0.0008, 0.0008, 9)
#: Fall of the sum of squares, in noise floors, from which loops are others: three parameters bring some 16 by chance in
#: one recording of a thousand.
_DIFFERENT: Final = 25.0
#: Ratio of what the fitted loops leave to the noise from which they are not understood.
_UNDERSTOOD: Final = 1.1
#: Share of the drive's limit from which a torque counts as limited.
_LIMITED: Final = 0.95
#: Share of the inertia that must be left out of a torque for it to be fed forward, and by how much of itself what loops
#: and motion say of it may differ.
_LEAST_SHARE: Final = 0.03
_SAME: Final = 0.2
#: Share by which gains may be off the model's to count as the same beside a lag.
_GAINS: Final = 0.03
#: Deviations by which a gain or lag must be off the model's: several are looked at on every axis.
_CERTAIN: Final = 4.0


@dataclass(frozen=True)
class Loop:
    """The loops of one drive as they were found; deviations are standard errors."""

    axis: int
    kp_Nm_s_per_rad: float
    ki_Nm_per_rad: float
    lag_s: float
    kp_deviation: float
    ki_deviation: float
    lag_deviation_s: float
    gain: float  #: fall of the sum of squares against the model's loops, in noise floors
    ratio: float  #: rms of what is left over the noise floor
    is_fed_forward: bool = False  #: the model's loops, and a torque beside them that goes with the motion

    @property
    def is_known(self) -> bool:
        """True if the model's loops explain the torque as well as any."""
        return self.is_fed_forward or (self.gain < _DIFFERENT and self.is_understood)

    @property
    def is_understood(self) -> bool:
        """True if any loops of this kind explain the torque."""
        return self.ratio < _UNDERSTOOD

    def is_only_late(self, model: ModelParameters) -> bool:
        """True if its gains are the model's, and it differs from the model's by nothing but a lag."""
        if model.drives is None or not self.is_understood:
            return False
        kp, ki, _ = _of_model(model.drives, self.axis)
        off_kp, off_ki = abs(self.kp_Nm_s_per_rad - kp), abs(self.ki_Nm_per_rad - ki)
        return max(off_kp / kp, off_ki / ki) < _GAINS or (
            off_kp < _CERTAIN * self.kp_deviation and off_ki < _CERTAIN * self.ki_deviation
        )


def _of_model(drives: DriveParameters, axis: int) -> tuple[float, float, float]:
    """Gains of the velocity loop, N·m·s/rad and N·m/rad, and lag of the current loop, s, of an axis by the model."""
    gains = drives.velocity_kp_Nm_s_per_rad, drives.velocity_ki_Nm_per_rad
    kp, ki, lag_s = (per_item(each, axis) for each in (*gains, drives.current_loop_time_constant_s))
    return kp, ki, lag_s


@dataclass(frozen=True)
class DriveRecord:
    """Data of one axis: its commands, motion and torque."""

    axis: int
    command_m_s: Array  #: (n,), each held for a row
    travel_m: Array  #: (fine,) on a grid `whole` times that of the rows
    speed_m_s: Array  #: (fine,)
    torque_Nm: Array  #: (n,)
    floor_Nm: float  #: of the torque in the band
    fed_forward: Array  #: (k, rows in the band) what a torque that is fed forward goes with: acceleration first
    lacking: float  #: N·m per m/s² by which the torque is more than the motion needs
    inertia: float  #: N·m per m/s² that it should need


def loop_of(
    drive: DriveRecord,
    model: ModelParameters,
    period_s: float,
    thin: Callable[[Array], Array],
    rows: NDArray[np.bool_],
    row_s: float,
) -> Loop | None:
    """The loops of one drive; None without drives in the model, or where there are no rows to see them on.

    thin: from rows of the recording to those in the band, `row_s` apart; rows: of these the ones that count.
    """
    drives = model.drives
    if drives is None or np.count_nonzero(rows) < 100:
        return None
    axis = drive.axis
    kp, ki, lag_s = _of_model(drives, axis)
    limit = _LIMITED * per_item(drives.torque_limit_Nm, axis)
    limited = uniform_filter1d((np.abs(drive.torque_Nm) > limit).astype(np.float64), round(0.5 / period_s) | 1)
    rows = rows & (np.abs(thin(limited)) < 1e-6)
    quick = without_slow(rows, row_s)

    def of_rows(thinned: Array) -> Array:
        return quick(thinned)[rows] / drive.floor_Nm

    def seen(values: Array) -> Array:
        return of_rows(thin(values))

    torque = seen(drive.torque_Nm)
    terms = _loop_terms(drive, model.motor_rad_per_m(axis), period_s, drives.sample_time_s)

    def columns(lag: float) -> Array:
        return np.array([seen(each) for each in terms(lag)])

    def fitted(at: Array, wanted: Array) -> tuple[float, Array]:
        theta, *_ = np.linalg.lstsq(at.T, wanted, rcond=None)
        return float(np.sum((wanted - theta @ at) ** 2)), np.asarray(theta, np.float64)

    def best(beside: Array) -> tuple[float, float, Array]:
        """Least square over the lags with these columns in addition to the loop's, the lag, and what is fitted."""

        def at(lag: float) -> tuple[float, Array]:
            return fitted(np.vstack([columns(float(lag)), beside]), torque)

        near = min(_LAGS_S, key=lambda lag: at(lag)[0])
        lag = float(min(np.maximum(near + _CLOSER_S, 0.0), key=lambda lag: at(lag)[0]))
        return at(lag)[0], lag, at(lag)[1]

    nothing = np.empty((0, len(torque)))
    square, best_s, theta = best(nothing)
    if not np.all(np.isfinite(theta)):
        return None
    at = columns(best_s)
    rest = torque - np.array([kp, ki]) @ columns(lag_s)
    mine = float(np.sum(rest**2))
    is_fed_forward = False
    if mine - square > _DIFFERENT:
        beside = np.array([of_rows(each) for each in drive.fed_forward])
        with_mine, shares = fitted(beside, rest)
        # What is left out of the torque is missing in both: the answer of the loops, and what the motion needs.
        left_out = float(shares[0])
        is_fed_forward = bool(
            with_mine < _UNDERSTOOD**2 * len(torque)
            and abs(drive.lacking) > _LEAST_SHARE * drive.inertia
            and abs(left_out - drive.lacking) < _SAME * abs(drive.lacking)
        )
    slope = (theta @ columns(best_s + 2e-4) - theta @ at) / 2e-4
    jacobian = np.vstack([at, slope])
    ratio = float(np.sqrt(square / len(torque)))
    deviations = np.sqrt(np.maximum(np.diag(np.linalg.pinv(jacobian @ jacobian.T)), 0.0)) * max(ratio, 1.0)
    of_kp, of_ki, of_lag = map(float, deviations)
    found_kp, found_ki = map(float, theta)
    return Loop(axis, found_kp, found_ki, best_s, of_kp, of_ki, of_lag, mine - square, ratio, is_fed_forward)


def _loop_terms(
    drive: DriveRecord, rad_per_m: float, period_s: float, sample_s: float
) -> Callable[[float], tuple[Array, Array]]:
    """Factors of kp and ki, at the rows (n,), for a lag of the current loop."""
    n = len(drive.command_m_s)
    per_row = max(1, round(period_s / sample_s))
    at = np.arange(n * per_row) * (period_s / per_row)
    fine = np.linspace(0.0, (n - 1) * period_s, len(drive.speed_m_s))
    command = np.repeat(drive.command_m_s, per_row)
    error = rad_per_m * (command - np.interp(at, fine, drive.speed_m_s))
    asked = np.concatenate([[0.0], np.cumsum(command)]) * (period_s / per_row)
    # A sample's integral holds its own error already: the sum of the speeds reaches half a sample ahead.
    integral = rad_per_m * (asked[1:] - np.interp(at + 0.5 * period_s / per_row, fine, drive.travel_m))
    integral -= np.mean(integral)

    def lagging(lag_s: float) -> tuple[Array, Array]:
        decay = float(np.exp(-period_s / per_row / lag_s)) if lag_s > 0.0 else 0.0
        found = []
        for values in (error, integral):
            late = lfilter([0.0, 1.0 - decay], [1.0, -decay], values)
            found.append(np.asarray(late[::per_row], np.float64))
        return found[0], found[1]

    return lagging


def nuisance_of(loop: Loop, model: Machine) -> dict[str, dict[str, tuple[float, tuple[float, float], str]]]:
    """Certain differences of a drive's loops from the model's: by effect and parameter the value, interval and unit."""
    if model.drives is None or loop.is_known or not loop.is_understood:
        return {}
    kp, ki, lag_s = _of_model(model.drives, loop.axis)

    def value(estimate: float, deviation: float, of: float) -> tuple[float, tuple[float, float], str]:
        middle, half = estimate / of - 1.0, NORMAL_95 * deviation / of
        return middle, (middle - half, middle + half), "1"

    found: dict[str, dict[str, tuple[float, tuple[float, float], str]]] = {}
    if abs(loop.kp_Nm_s_per_rad - kp) > _CERTAIN * loop.kp_deviation or (
        abs(loop.ki_Nm_per_rad - ki) > _CERTAIN * loop.ki_deviation
    ):
        found["drive_gain"] = {
            "kp_relative_change": value(loop.kp_Nm_s_per_rad, loop.kp_deviation, kp),
            "ki_relative_change": value(loop.ki_Nm_per_rad, loop.ki_deviation, ki),
        }
    half_s = NORMAL_95 * loop.lag_deviation_s
    if abs(loop.lag_s - lag_s) > _CERTAIN * loop.lag_deviation_s:
        more_s = loop.lag_s - lag_s
        found["drive_lag"] = {"lag_s": (more_s, (more_s - half_s, more_s + half_s), "s")}
    return found
