"""Whole recordings of a servo axis in one compiled call: for the diagnosis, the estimators' tests, and plots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.plant import drive_loops as loops
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.servo_axis import kernel
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import Vector


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
    rows = np.ascontiguousarray(commands, dtype=np.float64)
    if rows.ndim != 1 or lay.motor_count(many[0]) != 1 or np.ndim(external_torque_Nm) > 1:
        raise ValueError(f"commands {rows.shape} for {lay.motor_count(many[0])} motors, expected (n,) for one")
    outside = np.array(np.broadcast_to(np.asarray(external_torque_Nm, dtype=np.float64), rows.shape))
    shape = (len(many), len(lay.new_state(many[0])))
    states = np.array(np.broadcast_to(np.atleast_2d(state), shape), order="C")
    inputs = lay.new_inputs(many[0])
    lay.motor_inputs(inputs)[:, loops.IN_MODE] = mode
    samples = samples_per(dt_s, many.item(lay.P_SAMPLE_TIME_S))
    out = np.empty((len(many), len(rows), lay.output_size(many[0])))

    def run(share: slice) -> None:
        kernel.simulate(many[share], states[share], inputs.copy(), rows[:, None], outside, samples, out[share])

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out, states = out[0], states[0]
    return Simulation(out[..., lay.O_X], out[..., lay.O_V], out[..., lay.O_TORQUE], out[..., lay.O_MEAN], states)
