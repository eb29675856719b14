"""What a cycle of the twin costs: estimation with everything it watches, and the step of its machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

import numpy as np
from numpy.typing import NDArray
from tests.simulated_measurements import simulated_measurements

from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.plant.motor_port import FEEDBACK_SIZE, MotorMode
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.web_line import SMALLEST, boundary
from hilbench.twin.machines.machine import InVectors, MachineVectors
from hilbench.twin.machines.web_line import WebLineTwin
from performance.table import Section

_CYCLE_S, _RUNS = 0.002, 5
#: Cycles of a run, and those before them, by which the web is under way.
_CYCLES, _BEFORE = 3000, 600
_BESIDE = 64
#: Columns of an axis in what a machine in vectors takes, and the places of position and torque among them.
_MEASURED_SIZE, _POSITION, _TORQUE = 4, 0, 2

Rows = NDArray[np.float64]


def measure(model: ModelParameters) -> Section:
    """CPU time of the thread of a cycle, the shortest of several runs; one twin, then some beside each other."""
    section = Section(
        "The twin, one span",
        "CPU of a cycle of the twin without its devices, the default method: what was measured in, compared and "
        f"estimated, the machine simulated for {1000.0 * _CYCLE_S:g} ms, what is shown out. In a fast-path cycle that "
        "is one compiled call.",
    )
    fast = min(_run(model, 1, _in_vectors) for _ in range(_RUNS))
    section.add("a fast-path cycle", 1e6 * fast, "µs")
    many = _run(model, _BESIDE, _in_vectors) / _BESIDE
    section.add(f"each of {_BESIDE} beside each other", 1e6 * many, "µs", many / fast, "a fast-path cycle")
    objects = min(_run(model, 1, _by_objects) for _ in range(_RUNS))
    section.add("a cycle by objects", 1e6 * objects, "µs", objects / fast, "a fast-path cycle")
    return section


class _Inputs:
    """What two axes measure and are asked for: angles and speeds of the motors (T, 2) in rad and rad/s, torques (T, 2)
    in N·m."""

    def __init__(self, model: ModelParameters, count: int) -> None:
        self.model = model
        speed = 3.0 * np.minimum(np.arange(count) * _CYCLE_S, 1.0)
        data = simulated_measurements(
            model, np.column_stack([speed, speed]), np.full(count, model.youngs_modulus_Pa(1))
        )
        per_m = [model.motor_rad_per_m(axis) for axis in (1, 2)]
        self.angles, self.speeds = data.x_m * per_m, data.v_cmd_m_s * per_m
        self.torques = np.column_stack([np.zeros(count), data.tau2_Nm])


def _run(model: ModelParameters, twins: int, cycles: Callable[[list[WebLineTwin], _Inputs, int], None]) -> float:
    """Seconds of a cycle of so many twins."""
    count = _CYCLES if twins == 1 else _CYCLES // 10
    inputs, told = _Inputs(model, _BEFORE + count), boundary(model, SMALLEST).__getitem__
    machines = [WebLineTwin(model, EstimationConfig(), _CYCLE_S, told) for _ in range(twins)]
    for port in (port for machine in machines for port in machine.ports):
        port.mode, port.slope = MotorMode.VELOCITY, inf
    _go_on(machines, inputs, range(_BEFORE))
    start_ns = time.thread_time_ns()
    cycles(machines, inputs, count)
    return (time.thread_time_ns() - start_ns) * 1e-9 / count


def _go_on(machines: list[WebLineTwin], inputs: _Inputs, rows: range) -> None:
    for row in rows:
        measured = list(zip(inputs.angles[row].tolist(), inputs.torques[row].tolist(), strict=True))
        for machine in machines:
            machine.compare(row * _CYCLE_S, measured)
            machine.listen()
            for port, set_point in zip(machine.ports, inputs.speeds[row].tolist(), strict=True):
                port.setpoint = set_point
            machine.plant.step(_CYCLE_S)
            machine.published()


def _by_objects(machines: list[WebLineTwin], inputs: _Inputs, count: int) -> None:
    _go_on(machines, inputs, range(_BEFORE, _BEFORE + count))


def _in_vectors(machines: list[WebLineTwin], inputs: _Inputs, count: int) -> None:
    axes = inputs.angles.shape[1]
    measured, asked, shown = np.zeros(_MEASURED_SIZE * axes), np.zeros(axes), np.zeros(FEEDBACK_SIZE * axes)
    going = [_begun(inputs.model, machine, measured, asked, shown.copy()) for machine in machines]
    for row in range(_BEFORE, _BEFORE + count):
        measured[_POSITION::_MEASURED_SIZE] = inputs.angles[row]
        measured[_TORQUE::_MEASURED_SIZE] = inputs.torques[row]
        asked[:] = inputs.speeds[row]
        for each in going:
            code = each.piece.function(each.piece.argument, each.piece.table)
            if code != each.piece.continues:
                each.go_on_from(code)


def _begun(model: ModelParameters, machine: WebLineTwin, measured: Rows, asked: Rows, shown: Rows) -> InVectors:
    """The machine in vectors of its own; number and status of the SYNC are the only whole numbers."""
    told, published = boundary(model, SMALLEST), len(machine.published())
    values = np.array([*told.values(), *[0.0] * published])
    places = dict(zip(told, range(len(told)), strict=True))
    behind = range(len(told), len(values))
    return machine.in_vectors(
        MachineVectors(measured, asked, shown, values, places, behind, np.zeros(2, np.int64), number=0, status=1),
        fallback=lambda code: False,
    )
