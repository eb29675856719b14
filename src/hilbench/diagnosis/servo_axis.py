"""A servo axis, as a diagnosis varies and predicts it (part `diagnosis` of a kind of machine)."""

from __future__ import annotations

from typing import Final

import numpy as np

from hilbench.arrays import Array, Rows
from hilbench.diagnosis.coupling import Arm
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion, coupled_motion
from hilbench.diagnosis.predictor import RECORDED_COMMANDS, Choice, Predictor, is_cycle
from hilbench.diagnosis.residual_analysis import Condition, of_motion
from hilbench.plant.effect import Effect, MachineSizes, Section
from hilbench.plant.servo_axis.effects import KIND, ShaftEffect
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation, simulate_emulated
from hilbench.plant.servo_axis.layout import pack as pack
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.sizes import machine_sizes
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line.inverse import required_torque_Nm as required_torque_Nm
from hilbench.topology.config import BenchConfig

ENTRY: Final = ShaftEffect
#: Speed below which the shaft is at rest.
_STANDSTILL_RAD_S: Final = 0.1
#: Speed from which a recording counts as begun in motion, and how long its start is then left out, s.
_MOVES_RAD_S, _SETTLES_S = 0.2, 1.0
_TURN: Final = 2.0 * np.pi


class AxisFreeRun(Predictor):
    """Torque of a bench's drive by a free run: the emulated axis under its load model, on the recorded commands. The
    motion follows these too closely to say more of the shaft than the torque."""

    names = ("tau1_Nm",)
    emulation: ShaftEmulation

    def __init__(self, model: ServoAxisParameters, data: Measured, emulation: ShaftEmulation) -> None:
        """`data` needs commands; a row each cycle of the emulation."""
        self.emulation, self._model, self._data = emulation, model, data
        self._commands = emulation.as_taken(data.commands_m_s[:, 0])
        self.measured, self.tolerances = data.tau_Nm[1][None], np.zeros(1)
        in_motion = abs(self._commands[0]) > _MOVES_RAD_S
        self._start = (float(data.x_m[1][0]), float(self._commands[0]) if in_motion else 0.0)
        self.rows: Rows = data.usable_in_motion(np.abs(self._commands) < _STANDSTILL_RAD_S)
        if in_motion:
            self.rows[: round(_SETTLES_S / data.period_s)] = False

    def conditions(self, parameters: Array) -> list[Condition]:
        """Time and motion."""
        data, speed = self._data, self._commands
        x, ratio = data.x_m[1], self._model.shaft.gear_ratio
        found = [
            *of_motion(data.t_s, 1, "rad", speed, np.gradient(speed, data.period_s)),
            Condition("angle of the motor", "rad", x, period=_TURN, spectral=True),
        ]
        if ratio != 1.0:
            found.append(Condition("angle behind the gear", "rad", x / ratio, period=_TURN, spectral=True))
        return found

    def predict(self, parameters: Array) -> Array:
        """(B, P) to (B, 1, n)."""
        run = simulate_emulated(self.emulation, self._model, parameters, self._commands, self._start)
        return run.tau_Nm[:, None, :]


def write_effect(
    model: ServoAxisParameters,
    parameters: Array,
    effect: Effect,
    axis: int | None,
    slot: int,
    values: dict[str, float],
    section: Section | None,
) -> None:
    """Write an effect's values into a parameter vector; others stay."""
    line.write_effect(parameters, effect.id, 1, slot, values, kind=KIND)


def sizes(
    model: ServoAxisParameters, axis: int | None, top_speed: float, torque_Nm: float, sample_time_s: float | None
) -> MachineSizes:
    """Usual sizes at the shaft."""
    return machine_sizes(model, top_speed_rad_s=top_speed, torque_Nm=torque_Nm, sample_time_s=sample_time_s)


def turns_apart(model: ServoAxisParameters, axis: int) -> bool:
    """False: motor and load are one shaft."""
    return False


def Nm_per_acceleration(model: ServoAxisParameters, axis: int) -> float:
    """Inertia of all that turns, kg·m²."""
    return model.inertia_kg_m2


def choice(model: ServoAxisParameters, data: Measured, emulation: AnyEmulation | None) -> Choice:
    """A free run of what was emulated, with a row each cycle; else on measured motion."""
    if not data.emulated and (beside := coupled_motion(model, data)) is not None and beside.arm is not None:
        gravity = "; gravity goes with the angles of both" if beside.arm is Arm.CARRIED else ""
        return Choice(beside, f"measured motion of an axis {beside.arm}, below {beside.corner_hz:.2g} Hz{gravity}")
    if not data.emulated or not data.commands_m_s.size:
        return Choice(OnMeasuredMotion(model, data), "measured motion of a lone axis")
    given = emulation if isinstance(emulation, ShaftEmulation) else None
    shaft = given or ShaftEmulation(data.period_s, ServoRigParameters.matching(model))
    if not is_cycle(data.period_s / shaft.cycle_s) or round(data.period_s / shaft.cycle_s) != 1:
        return Choice(OnMeasuredMotion(model, data), "measured motion: there is not a row each cycle")
    return Choice(AxisFreeRun(model, data, shaft), RECORDED_COMMANDS)


def emulation(config: BenchConfig, resolution: tuple[float, ...] | None) -> ShaftEmulation | None:
    """Emulation by the load motor; None without one. `resolution`: rad/s, of each axis's velocity command."""
    if not config.load_motors:
        return None
    stand = config.servo_rig_parameters(effects=())
    return ShaftEmulation(config.cycle_time_s, stand, None if resolution is None else resolution[0])
