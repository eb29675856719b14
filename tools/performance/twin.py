"""What a cycle of the twin costs: estimation with everything it watches, and the step of its machine."""

from __future__ import annotations

import time
from math import inf

import numpy as np

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.synthetic import simulated_measurements
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.twin.machines.web_line import WebLineTwin, boundary
from performance.table import Section

_CYCLE_S, _CYCLES, _RUNS = 0.002, 3000, 5
_BESIDE = 64


def measure(model: ModelParameters) -> Section:
    """CPU time of the thread of a cycle, the shortest of several runs; one twin, then some beside each other."""
    section = Section(
        "The twin, one span",
        "CPU of a cycle of the twin without its devices, the default method: what was measured in, compared and "
        f"estimated, the machine simulated for {1000.0 * _CYCLE_S:g} ms, what is shown out.",
    )
    one = min(_run(model, 1) for _ in range(_RUNS))
    section.add("one twin", 1e6 * one, "µs")
    many = _run(model, _BESIDE) / _BESIDE
    section.add(f"each of {_BESIDE} beside each other", 1e6 * many, "µs", many / one, "one twin")
    return section


def _run(model: ModelParameters, twins: int) -> float:
    """Seconds of a cycle of so many twins."""
    count = _CYCLES if twins == 1 else _CYCLES // 10
    speed = 3.0 * np.minimum(np.arange(count) * _CYCLE_S, 1.0)
    modulus = np.full(count, model.youngs_modulus_Pa(1))
    data = simulated_measurements(model, np.column_stack([speed, speed]), modulus)
    per_m = [model.motor_rad_per_m(axis) for axis in (1, 2)]
    told = boundary(model).__getitem__
    machines = [WebLineTwin(model, EstimationConfig(), _CYCLE_S, told) for _ in range(twins)]
    torques = np.column_stack([np.zeros(count), data.tau2_Nm]).tolist()
    angles, speeds = (data.x_m * per_m).tolist(), (data.v_cmd_m_s * per_m).tolist()
    measured = [list(zip(angle, torque, strict=True)) for angle, torque in zip(angles, torques, strict=True)]
    for machine in machines:
        for port in machine.ports:
            port.mode, port.slope = MotorMode.VELOCITY, inf
    start_ns = time.thread_time_ns()
    for row in range(count):
        for machine in machines:
            machine.compare(row * _CYCLE_S, measured[row])
            machine.listen()
            for port, set_point in zip(machine.ports, speeds[row], strict=True):
                port.setpoint = set_point
            machine.plant.step(_CYCLE_S)
            machine.published()
    return (time.thread_time_ns() - start_ns) * 1e-9 / count
