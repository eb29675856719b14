"""Offline estimator on a recording, row by row, with the closed-loop model in parallel as in the twin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.servo_axis.balance import ShaftSample
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.estimation.servo_axis.inertia import InertiaEstimator
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.offline import simulate
from hilbench.plant.servo_axis.parameters import ServoAxisParameters


@dataclass(frozen=True, slots=True)
class ShaftRecording:
    """Inputs of a twin, one row (n,) a cycle; SI, at the motor shaft."""

    cycle_s: float
    v_cmd_rad_s: Array
    x_rad: Array
    tau_Nm: Array


@dataclass(frozen=True, slots=True)
class ShaftTrack:
    """Estimates over a recording; arrays (n,)."""

    inertia_kg_m2: Array
    deviation_kg_m2: Array
    separable: Array
    also: dict[str, tuple[Array, Array]]  #: value and deviation by name


def track(model: ServoAxisParameters, config: InertiaConfig, data: ShaftRecording) -> ShaftTrack:
    """Run the estimator over a recording. Raises ValueError as `hilbench.plant.servo_axis.offline.simulate`."""
    parameters = lay.pack(model)
    model_run = simulate(parameters, lay.new_state(parameters), data.v_cmd_rad_s, data.cycle_s, MotorMode.VELOCITY)
    ends = np.concatenate([[0.0], 0.5 * (model_run.tau_Nm[1:] + model_run.tau_Nm[:-1])])
    ripple = np.where(np.arange(len(ends)) > 0, model_run.mean_tau_Nm - ends, 0.0)
    estimator, n = InertiaEstimator(config, model), len(data.x_rad)
    inertia, deviation, separable = np.empty(n), np.empty(n), np.empty(n, dtype=bool)
    also: dict[str, tuple[Array, Array]] = {}
    for row in range(n):
        estimate = estimator.update(ShaftSample(data.cycle_s, data.x_rad[row], data.tau_Nm[row], ripple[row]))
        inertia[row], deviation[row] = estimate.inertia_kg_m2, estimate.deviation_kg_m2
        separable[row] = estimate.separable
        for nuisance in estimate.also:
            values = also.setdefault(nuisance.name, (np.full(n, np.nan), np.full(n, np.nan)))
            values[0][row], values[1][row] = nuisance.value, nuisance.deviation
    return ShaftTrack(inertia, deviation, separable, also)
