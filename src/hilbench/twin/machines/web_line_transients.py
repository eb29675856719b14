"""Simulated tension transients: torque residuals to the twin after a step of E in a section with a carriage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilbench.compiled import Vector
from hilbench.estimation.web_line.transients import TransientDetector
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.drive_response import DriveResponse
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower, StateTransfer
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sections import section_spans
from hilbench.plant.web_line.sensitivity_model import damped_follower

#: Steps of E as shares: a stiffer web oscillates faster.
_SHARES: Final = (-0.5, -0.3, -0.15, 0.15, 0.3, 0.5)
#: Settling time of the line before the step, simulated duration of its transient; share of its energy that is used.
_SETTLE_S, _TRANSIENT_S, _MOST = 0.9, 0.24, 0.9


def transient_detector(
    model: ModelParameters, axis: int, rows: Sequence[int], response: DriveResponse, cycle_s: float
) -> TransientDetector:
    """Transient detector of the section after an axis; `rows`: indices of usable torques, from 0; `response`: of the
    drives, to one load each."""
    transients = np.stack([_transient(model, axis, share, cycle_s)[:, rows] / share for share in _SHARES])
    energy = np.cumsum(np.sum(transients**2, axis=(0, 2)))
    cycles = int(np.searchsorted(energy, _MOST * energy[-1])) + 1
    response.reset()
    loads = []
    for _ in range(cycles):
        loads.append(response.torques_Nm[rows, 0])
        response.step(np.ones((model.axis_count, 1)))
    return TransientDetector(transients[:, :cycles], np.array(loads))


def _transient(model: ModelParameters, axis: int, share: float, cycle_s: float) -> Vector:
    """Torques (cycles, N) of a line at rest after a step of E, less those of a twin following its motion."""
    pair = _Pair(model, cycle_s)
    for _ in range(round(_SETTLE_S / cycle_s)):
        pair.step()
    before = pair.torques_Nm
    for k in section_spans(model, axis):
        pair.line.set_parameter(f"span{k + 1}.youngs_modulus_Pa", (1.0 + share) * model.youngs_modulus_Pa(k + 1))
    found = []
    for _ in range(round(_TRANSIENT_S / cycle_s)):
        found.append(pair.torques_Nm - before)
        pair.step()
    return np.array(found)


class _Pair:
    """Line at rest, and its twin that follows it."""

    def __init__(self, model: ModelParameters, cycle_s: float) -> None:
        axes = range(1, model.axis_count + 1)
        self._ports, self._twins = ([MotorPort(mode=MotorMode.VELOCITY) for _ in axes] for _ in range(2))
        self.line, self._closed = Line(model, self._ports), Line(model, self._twins)
        self._followed: LineFollower = damped_follower(model)
        self._per_m = [model.motor_rad_per_m(axis) for axis in axes]
        self._cycle_s = cycle_s
        for line in (self.line, self._closed):
            line.lock_to(cycle_s)
        self._transfer = StateTransfer(self._followed, self._closed)
        self._followed.reset(self._positions_m)
        self._transfer()

    @property
    def _positions_m(self) -> list[float]:
        return [port.position_rad / per_m for port, per_m in zip(self._ports, self._per_m, strict=True)]

    @property
    def torques_Nm(self) -> Vector:
        """Torques of the line, less those of its twin (N,)."""
        return np.array([a.torque_Nm - b.torque_Nm for a, b in zip(self._ports, self._twins, strict=True)])

    def step(self) -> None:
        """Step both by a cycle."""
        self.line.step(self._cycle_s)
        self._closed.step(self._cycle_s)
        self._followed.follow(self._positions_m, self._cycle_s)
        self._transfer()
