"""Offline twin: simulation and estimation on a recording, row by row, instead of a bus."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from hilbench.arrays import Array
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.plausibility import STANDSTILL_M_S
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.even_rows import EvenRows, even_rows
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.span_estimator import UNKNOWN_AT_REST, UNKNOWN_STRAIN, SpanEstimator
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters


@dataclass(frozen=True, slots=True)
class Track:
    """Estimates over a recording; arrays (n,)."""

    E_Pa: Array
    E_sd_Pa: Array
    F_sim_N: Array
    residual_Nm: Array
    nuisances: dict[str, tuple[Array, Array]]  #: value and deviation by name
    synchronizer_us: float | None  #: mean CPU time of a cycle of the method alone; None where it was not measured
    errors: tuple[Nuisance, ...] = ()  #: of the model, as they are known at the end


def remarks(model: ModelParameters, data: Measurements) -> list[str]:
    """Remarks for the user on how `run_offline` resamples the rows of a recording."""
    return _even_rows(model, data).remarks


def _even_rows(model: ModelParameters, data: Measurements) -> EvenRows:
    return even_rows(data, model.drives.sample_time_s if model.drives else data.cycle_s)


def run_offline(model: ModelParameters, config: EstimationConfig, data: Measurements) -> Track:
    """Run the twin of `model` over a recording, in cycles of its own where the rows are uneven (`even_rows`).

    Raises ValueError where `Line` and `MeasuredBalance` do.
    """
    even = _even_rows(model, data)
    cycles, cycle_s, tau2_Nm = even.data, even.cycle_s, even.data.tau2_Nm
    ports = (MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.VELOCITY))
    line = Line(model, ports)
    tracking = SpanEstimator(model, config, line, cycle_s)
    rad_per_m = [model.motor_rad_per_m(axis) for axis in (1, 2)]
    n = len(cycles.t_s)
    modulus, deviation, tension, residual = (np.empty(n) for _ in range(4))
    others: dict[str, tuple[Array, Array]] = {}
    spent_ns = 0
    _join(line, tracking, cycles, cycle_s, unknown_at_rest=config.web_at_rest == "unknown")
    for row in range(n):
        tension[row] = line.tension_N[0]
        strain_prev, F_next_N = cycles.strain_prev[row], cycles.F_next_N[row]
        before_ns = time.thread_time_ns()
        if even.measured[row]:
            measured = cycles.x_m[row, 0], cycles.x_m[row, 1], tau2_Nm[row]
            tracking.compare(*measured, ports[1].torque_Nm, strain_prev, F_next_N)
            tracking.look_for_known_change(float(cycles.v_cmd_m_s[row, 1]))
        else:
            tracking.miss()
        spent_ns += time.thread_time_ns() - before_ns
        estimate = tracking.estimate
        modulus[row], deviation[row] = estimate.youngs_modulus_Pa, estimate.deviation_Pa
        residual[row] = tracking.state["residual_Nm"]
        for nuisance in estimate.nuisances:
            values = others.setdefault(nuisance.name, (np.full(n, np.nan), np.full(n, np.nan)))
            values[0][row], values[1][row] = nuisance.value, nuisance.deviation
        for port, ratio, speed in zip(ports, rad_per_m, cycles.v_cmd_m_s[row], strict=True):
            port.setpoint = speed * ratio
        line.set_input("strain_prev", tracking.upstream_strain(strain_prev))
        line.set_input("F_next_N", F_next_N)
        line.step(cycle_s)
    at = even.held_rows
    return Track(
        modulus[at],
        deviation[at],
        _between(even, tension),
        residual[at],
        {name: (values[at], deviations[at]) for name, (values, deviations) in others.items()},
        spent_ns / 1000.0 / n,
        tracking.errors,
    )


def _join(line: Line, tracking: SpanEstimator, cycles: Measurements, cycle_s: float, *, unknown_at_rest: bool) -> None:
    """Start the simulation in motion, with an unknown web strain, if the recording begins in motion."""
    start_m = cycles.x_m[0]
    speeds = (cycles.x_m[min(1, len(cycles.x_m) - 1)] - start_m) / cycle_s
    if np.abs(speeds).max() <= STANDSTILL_M_S:
        if unknown_at_rest:
            tracking.release(UNKNOWN_AT_REST)
        return
    line.set_state({"x1_m": start_m[0], "x2_m": start_m[1], "v1_m_s": speeds[0], "v2_m_s": speeds[1]})
    line.set_state({"tau2_Nm": float(cycles.tau2_Nm[0])})
    tracking.release(UNKNOWN_STRAIN)


def _between(even: EvenRows, values: Array) -> Array:
    """Continuous cycle values (cycles,) at the times of the original rows (n,): monotone between two cycles, so that a
    step is no overshoot (Fritsch and Carlson 1980)."""
    at = even.held_rows
    if np.array_equal(at * even.cycle_s, even.times_s):
        return values[at]
    from scipy.interpolate import PchipInterpolator  # slow to import: deferred to its use

    cycles_s = np.arange(len(values)) * even.cycle_s
    return np.asarray(PchipInterpolator(cycles_s, values)(np.minimum(even.times_s, cycles_s[-1])), np.float64)
