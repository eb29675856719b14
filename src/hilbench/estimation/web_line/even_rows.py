"""Resampling of a web line's measurements to its twin's cycle: rows a cycle apart, some of them missing.

Rows that are whole sample times of the drives apart, but for the difference of two clocks, are taken as they are.
Others are resampled to a cycle of whole sample times: positions by cubic splines, whose error is below an encoder's
step; torque from the nearest row, as a mean of two would hide half of its noise; values held between two SYNCs (set
points, boundary inputs) from the last one. That cycle is hardly shorter than the rows are apart, so that no measurement
counts twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.estimation.row_times import CLOCKS_DIFFER, RowTimes, row_times
from hilbench.estimation.web_line.measurements import Measurements

Rows = NDArray[np.int64]

#: Share of a drive sample time by which a cycle may be shorter than the time between two rows.
_SHORTER = 0.1
#: A gap of more periods than this is not bridged by interpolation.
_BRIDGED = 1.5
#: Rounding tolerance, in cycles.
_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class EvenRows:
    """Measurements with one row a cycle; rows not `measured` repeat the last values."""

    data: Measurements
    cycle_s: float
    measured: NDArray[np.bool_]  #: (cycles,)
    times_s: Array  #: (n,) of the rows that there were, since the first, on the clock of the cycles

    @property
    def remarks(self) -> list[str]:
        """Remarks for the user on missing or resampled rows; empty if there are none."""
        found = []
        missing = int(np.count_nonzero(~self.measured))
        if missing:
            found.append(f"{missing} of {len(self.measured)} cycles have no row: E is held in them")
        if len(self.times_s) and not np.array_equal(self.held_rows * self.cycle_s, self.times_s):
            found.append(
                f"rows are brought to cycles of {1e3 * self.cycle_s:g} ms, which the drives can be simulated in"
            )
        return found

    @property
    def held_rows(self) -> Rows:
        """Cycle (n,) that contains each original row, or precedes it: discrete values are held until then."""
        return np.asarray(np.floor(self.times_s / self.cycle_s + _ROUNDING), np.int64)


def even_rows(data: Measurements, sample_s: float) -> EvenRows:
    """Resample rows to a cycle of whole sample times of the drives."""
    times = row_times(data.t_s, data.x_m)
    samples = times.period_s / sample_s
    cycle_s = round(max(round(samples), 1) * sample_s, 9)
    if times.even and abs(times.period_s / cycle_s - 1.0) <= CLOCKS_DIFFER:
        return _placed(data, times, cycle_s)
    return _interpolated(data, times, round(max(ceil(samples - _SHORTER), 1) * sample_s, 9))


def _placed(data: Measurements, times: RowTimes, cycle_s: float) -> EvenRows:
    """Place each row at its cycle."""
    count = int(times.periods[-1]) + 1
    measured = np.zeros(count, bool)
    measured[times.periods] = True
    if measured.all():
        return EvenRows(data, cycle_s, measured, _times(times.periods, cycle_s))
    last = np.searchsorted(times.periods, np.arange(count), side="right") - 1
    at_rows = Measurements(
        _times(np.arange(count), cycle_s),
        data.v_cmd_m_s[last],
        data.x_m[last],
        data.tau2_Nm[last],
        data.strain_prev[last],
        data.F_next_N[last],
    )
    return EvenRows(at_rows, cycle_s, measured, _times(times.periods, cycle_s))


def _times(cycles: Rows, cycle_s: float) -> Array:
    return np.asarray(cycles * cycle_s, np.float64)


def _interpolated(data: Measurements, times: RowTimes, cycle_s: float) -> EvenRows:
    """Interpolate cycles between the rows, up to the last one."""
    from scipy.interpolate import CubicSpline  # slow to import: deferred to its use

    t_s = times.times_s
    at_s = _times(np.arange(int(t_s[-1] / cycle_s + _ROUNDING) + 1), cycle_s)
    last = np.clip(np.searchsorted(t_s, at_s + _ROUNDING * cycle_s, side="right") - 1, 0, len(t_s) - 1)
    following = np.minimum(last + 1, len(t_s) - 1)
    nearest = np.where(at_s - t_s[last] <= t_s[following] - at_s, last, following)
    on_row = np.abs(at_s - t_s[last]) <= _ROUNDING * cycle_s
    measured = on_row | (t_s[following] - t_s[last] <= _BRIDGED * times.period_s)
    return EvenRows(
        Measurements(
            at_s,
            data.v_cmd_m_s[last],
            np.asarray(CubicSpline(t_s, data.x_m)(at_s), np.float64),
            data.tau2_Nm[nearest],
            data.strain_prev[last],
            data.F_next_N[last],
        ),
        cycle_s,
        measured,
        t_s,
    )
