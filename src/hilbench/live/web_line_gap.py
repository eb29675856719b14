"""Residual of the momentum balance of each roller, cycle by cycle, cheaply.

    r_k = (i/r)·τ_k − R_k(v_k) + F_k − F_(k−1) − m_k·v_k'        (0 but for noise where the model is right)

Motion and torques are measured, the tension follows from the measured motion by the model (`LineFollower`), effects
included. The residual is averaged over `SHORT` cycles, whose accelerations are differences of positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.compiled import record_at
from hilbench.diagnosis.web_line.free_run import remembered_m
from hilbench.live.machine import SHORT
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.driving_force import driving_force_N
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters

#: Cycles after one in which the plant was not measured in which what is emulated still catches up.
_CATCHES_UP = 4
#: Lengths of the longest span after which the web that was found in it, of unknown strain, has left: exp(-5) of it is
#: less than what a level may be off by.
_EXCHANGED: Final = 5.0


def exchanged_m(model: ModelParameters) -> float:
    """Travel of the web after which nothing is left of that which was in the spans."""
    return remembered_m(model, _EXCHANGED)


class ModelGap:
    """The gap of one model along a run of a line of N rollers, N·m at the motor of each; E is estimated in `spans`."""

    def __init__(self, model: ModelParameters, spans: Sequence[int], cycle_s: float) -> None:
        self._cycle_s = cycle_s
        self._axes = model.axis_count
        self._p = lay.pack(model)
        layout = Layout.of(self._p)
        rows, motors = layout.axis_rows(self._p), layout.motor_rows(self._p)
        self._mass_kg = (rows.motor_mass_kg + rows.roller_mass_kg) * (1.0 + rows.inertia_mismatch.relative_change)
        self._per_m, self._web_load = motors.rad_per_m[: self._axes].copy(), rows.web_load.copy()
        self._upstream_stiffness_N = float(record_at(self._p, lay.WEB).upstream_stiffness_N)
        self._follower = LineFollower(model)
        several = model.span_count > 1
        self._moduli = [f"span{span}.youngs_modulus_Pa" if several else "youngs_modulus_Pa" for span in spans]
        self._exchanged_m = exchanged_m(model)
        self.restart()

    def restart(self) -> None:
        """The next rows are not those that follow the last."""
        self._last: Array | None = None
        self._last_forces = np.empty((0, 2 * self._axes + 1))
        self._last_around = np.empty((0, 2))
        self._last_known = np.empty(0, bool)
        self._came_m = 0.0  # of web, since then

    def use_estimate(self, estimate: Array) -> None:
        """E of the web in the spans in which it is estimated (M,), from now on, Pa."""
        for name, modulus_Pa in zip(self._moduli, estimate.tolist(), strict=True):
            self._follower.set_parameter(name, modulus_Pa)

    def follow(self, channels: Mapping[str, Array], known: Rows) -> Array:
        """Residuals (n // SHORT, N) of the next rows (n,) of x{k}_m, tau{k}_Nm, strain_prev and F_next_N; n a multiple.

        NaN where a row is not known, or follows one; and until the web of the first row, of unknown strain, has left.
        """
        axes = range(1, self._axes + 1)
        x = np.column_stack([channels[f"x{k}_m"] for k in axes])
        torque = np.column_stack([channels[f"tau{k}_Nm"] for k in axes])
        around = np.column_stack([channels["strain_prev"], channels["F_next_N"]])
        forces = np.column_stack([torque, self._tensions(x, around)])
        # What acts while the speed goes from that before a row to that before the row so many further on.
        acting = np.concatenate([self._last_forces if len(self._last_forces) else forces[:1], forces])
        self._last_forces = forces[-1:]
        before = x[:1] if self._last is None else self._last
        known = np.concatenate([np.ones(len(before), bool) if self._last is None else self._last_known, known])
        self._last, self._last_known = x[-SHORT - 1 :], known[-SHORT - 1 :]
        positions = np.concatenate([before, x])
        lead = len(before)
        count = len(x) // SHORT
        result = np.empty((count, self._axes))
        for j in range(count):
            end = lead + (j + 1) * SHORT - 1
            self._came_m += abs(float(positions[end, -1] - positions[max(end - SHORT, 0), -1]))
            if self._came_m < self._exchanged_m or not np.all(known[max(end - SHORT - _CATCHES_UP, 0) : end + 1]):
                result[j] = np.nan
                continue
            result[j] = self._of(positions, end, acting[j * SHORT : (j + 1) * SHORT].mean(0))
        return result

    def _tensions(self, x: Array, around: Array) -> Array:
        """(n, N + 1): before, between and behind the rollers."""
        before = x[:0] if self._last is None else self._last[-1:]
        if self._last is None:
            self._follower.reset(x[0], strain=[around.item(0, 0)] * (self._axes - 1))
        rows, limits = np.concatenate([before, x]), np.concatenate([self._last_around, around])
        between = self._follower.follow_rows(rows, limits, self._cycle_s)[len(before) :]
        self._last_around = around[-1:]
        return np.column_stack([around[:, 0] * self._upstream_stiffness_N, between, around[:, 1]])

    def _of(self, positions: Array, end: int, forces: Array) -> Array:
        """Residual of the SHORT cycles up to row `end` of positions, with the means of torques and tensions (2 N +
        1,)."""
        first = end - SHORT
        if first < 1:
            return np.full(self._axes, np.nan)
        now, was = positions[end] - positions[end - 1], positions[first] - positions[first - 1]
        speed = (positions[end] - positions[first]) / (SHORT * self._cycle_s)
        acceleration = (now - was) / (SHORT * self._cycle_s**2)
        torque_Nm, tension_N = forces[: self._axes], forces[self._axes :]
        gap = np.empty(self._axes)
        for k in range(self._axes):
            driven_N = driving_force_N(self._p, k + 1, float(torque_Nm[k]), float(positions[end, k]), float(speed[k]))
            web_N = self._web_load[k] * (tension_N[k + 1] - tension_N[k])
            gap[k] = (driven_N + web_N - self._mass_kg[k] * acceleration[k]) / float(self._per_m[k])
        return gap
