"""Prediction of a bench's servo axis by a free run: the emulated axis under its load model, on the recorded
commands."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import floor
from hilbench.diagnosis.residual_analysis import Condition
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation, simulate_emulated
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

#: Speed below which the shaft is at rest, where dry friction is not one law but many, how long that acts on what comes
#: after it, s, and the share of a recording that may be left out.
_STANDSTILL_RAD_S: Final = 0.1
_MOVING_S: Final = 0.25
_MOSTLY: Final = 0.6
#: Speed from which a recording counts as begun in motion, and how long its start is then left out, s.
_MOVES_RAD_S, _SETTLES_S = 0.2, 1.0
_TURN: Final = 2.0 * np.pi


class AxisFreeRun:
    """Torque of the drive. The motion follows the commands too closely to say more of the shaft than the torque."""

    def __init__(self, model: ServoAxisParameters, data: Measured, emulation: ShaftEmulation) -> None:
        """`data` needs commands; a row each cycle of the emulation."""
        self.emulation = emulation
        self._model, self._data = model, data
        self._commands = emulation.as_taken(data.commands_m_s[:, 0])
        self.names = ("tau1_Nm",)
        self.measured = data.tau_Nm[1][None]
        self.every = 1
        self.exact = True
        self.narrower = None
        self.tolerances = np.zeros(1)
        self._start = (float(data.x_m[1][0]), 0.0)
        if abs(self._commands[0]) > _MOVES_RAD_S:
            self._start = (float(data.x_m[1][0]), float(self._commands[0]))
        self.rows = self._usable()

    def _usable(self) -> NDArray[np.bool_]:
        """Rows without standstill and what it acts on, and without the transient of a start in motion."""
        data = self._data
        slow = np.abs(self._commands) < _STANDSTILL_RAD_S
        near = np.convolve(slow, np.ones(round(_MOVING_S / data.period_s) + 1), "full")[: len(slow)] > 0.0
        usable = ~near if np.mean(near) < _MOSTLY else np.ones(len(slow), bool)
        usable &= data.usable(_MOVING_S)
        if self._start[1] != 0.0:
            usable[: round(_SETTLES_S / data.period_s)] = False
        return np.asarray(usable)

    def floor(self, signal: int) -> float:
        """Noise floor from fourth differences of the measured torque."""
        return floor(self.measured[signal])

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time and motion."""
        data = self._data
        x, speed = data.x_m[1], self._commands
        found = [
            Condition("time", "s", data.t_s, spectral=True),
            Condition("speed of axis 1", "rad/s", speed),
            Condition("acceleration of axis 1", "rad/s²", np.gradient(speed, data.period_s)),
            Condition("angle of the motor", "rad", x, period=_TURN, spectral=True),
        ]
        ratio = self._model.shaft.gear_ratio
        if ratio != 1.0:
            found.append(Condition("angle behind the gear", "rad", x / ratio, period=_TURN, spectral=True))
        return found

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, 1, n)."""
        run = simulate_emulated(self.emulation, self._model, parameters, self._commands, self._start)
        return run.tau_Nm[:, None, :]
