"""Whole recordings of a servo axis in one compiled call: for the diagnosis, the estimators' tests, and plots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.compiled import Vector
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis.layout import U_TORQUE_NM
from hilbench.plant.web_line import offline as line
from hilbench.plant.web_line.layout import Layout


@dataclass(frozen=True, slots=True)
class Simulation:
    """Simulation result; arrays (..., n), values at the start of each row."""

    x_rad: Vector
    v_rad_s: Vector
    tau_Nm: Vector  #: torque as the drive reports it
    mean_tau_Nm: Vector  #: its mean over the time since the previous row
    state: Vector  #: (..., S) at the end, to continue from


def simulate(
    parameters: Vector,
    state: Vector,
    commands: NDArray[np.float64],
    dt_s: float,
    mode: MotorMode = MotorMode.VELOCITY,
    external_torque_Nm: ArrayLike = 0.0,
) -> Simulation:
    """Simulate recorded commands.

    parameters: (P,) of an axis without a load motor from `layout.pack`, or (B, P) for B variants, shared out among all
    cores; state: (S,) or (B, S), not changed. commands: (n,) set points by `mode` in rad/s, rad or N·m, each held for
    `dt_s`. external_torque_Nm: a number, or (n,), on the shaft, forward. Raises ValueError when `dt_s` is no multiple
    of the sample time, or shapes do not fit.
    """
    many = np.atleast_2d(np.ascontiguousarray(parameters))
    layout = Layout.of(many[0])
    rows = np.ascontiguousarray(commands, dtype=np.float64)
    if rows.ndim != 1 or layout.motors != 1 or np.ndim(external_torque_Nm) > 1:
        raise ValueError(f"commands {rows.shape} for {layout.motors} motors, expected (n,) for one")
    around = np.zeros((len(rows), 2))
    around[:, U_TORQUE_NM] = external_torque_Nm
    found = line.simulate(parameters, state, rows[:, None], around, dt_s, mode)
    assert found.mean_tau_Nm is not None, "it was simulated alone"
    of_motion, torques = (found.x_m[..., 0], found.v_m_s[..., 0]), (found.tau_Nm[..., 0], found.mean_tau_Nm[..., 0])
    return Simulation(*of_motion, *torques, found.state)
