"""A synchronizer on a recording instead of a bus: the twin's simulation and comparison, row by row."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.tracking import Tracking
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measurements:
    """What a twin would have heard, one row a cycle; SI, positions and velocities at the web, torque at the motor."""

    t_s: Array  #: (n,)
    v_cmd_m_s: Array  #: (n, 2)
    x_m: Array  #: (n, 2)
    tau2_Nm: Array  #: (n,)
    strain_prev: Array  #: (n,)
    F_next_N: Array  #: (n,)

    @property
    def cycle_s(self) -> float:
        """Time between two rows."""
        return float((self.t_s[-1] - self.t_s[0]) / (len(self.t_s) - 1))


@dataclass(frozen=True, slots=True)
class Track:
    """What a method made of a recording; arrays (n,)."""

    E_Pa: Array
    E_sd_Pa: Array
    F_sim_N: Array
    residual_Nm: Array
    nuisances: dict[str, tuple[Array, Array]]  #: value and deviation by name
    synchronizer_us: float | None  #: mean CPU time of a cycle of the method alone; None where it was not measured


def run_offline(model: ModelParameters, config: EstimationConfig, data: Measurements) -> Track:
    """Run the twin of `model` over a recording. Raises ValueError where `Line` and `MeasuredBalance` do."""
    cycle_s = round(data.cycle_s, 9)
    ports = (MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.VELOCITY))
    line = Line(model, ports)
    tracking = Tracking(model, config, line, ports[1], cycle_s)
    rad_per_m = [model.motor_rad_per_m(axis) for axis in (1, 2)]
    n = len(data.t_s)
    modulus, deviation, tension, residual = (np.empty(n) for _ in range(4))
    others: dict[str, tuple[Array, Array]] = {}
    spent_ns = 0
    for row in range(n):
        tension[row] = line.tension_N[0]
        before_ns = time.thread_time_ns()
        tracking.compare(
            row * cycle_s,
            data.x_m[row, 0],
            data.x_m[row, 1],
            data.tau2_Nm[row],
            data.strain_prev[row],
            data.F_next_N[row],
        )
        spent_ns += time.thread_time_ns() - before_ns
        estimate = tracking.estimate
        modulus[row], deviation[row] = estimate.youngs_modulus_Pa, estimate.deviation_Pa
        residual[row] = tracking.residual_Nm
        for nuisance in estimate.nuisances:
            values = others.setdefault(nuisance.name, (np.full(n, np.nan), np.full(n, np.nan)))
            values[0][row], values[1][row] = nuisance.value, nuisance.deviation
        for port, ratio, speed in zip(ports, rad_per_m, data.v_cmd_m_s[row], strict=True):
            port.setpoint = speed * ratio
        line.set_input("strain_prev", tracking.upstream_strain(data.strain_prev[row]))
        line.set_input("F_next_N", data.F_next_N[row])
        line.step(cycle_s)
    return Track(modulus, deviation, tension, residual, others, spent_ns / 1000.0 / n)
