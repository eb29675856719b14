"""A servo axis, as a diagnosis varies and predicts it (part `diagnosis` of a kind of machine)."""

from __future__ import annotations

from typing import Final

from hilbench.arrays import Array
from hilbench.diagnosis.axis_free_run import AxisFreeRun
from hilbench.diagnosis.coupling import Arm
from hilbench.diagnosis.machines import AnyEmulation
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion, coupled_motion
from hilbench.diagnosis.predictor import RECORDED_COMMANDS, Choice, is_cycle
from hilbench.plant.effect import Effect, MachineSizes, Section
from hilbench.plant.servo_axis.effects import KIND, ShaftEffect
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.servo_axis.layout import pack as pack
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ServoRigParameters
from hilbench.plant.servo_axis.sizes import machine_sizes
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line.inverse import required_torque_Nm as required_torque_Nm
from hilbench.topology.config import BenchConfig

ENTRY: Final = ShaftEffect


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
