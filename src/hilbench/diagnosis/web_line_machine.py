"""A web line, as a diagnosis varies and predicts it (part `diagnosis` of a kind of machine)."""

from __future__ import annotations

from typing import Final

from hilbench.arrays import Array
from hilbench.diagnosis.machines import AnyEmulation, is_lone
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.predictor import RECORDED_COMMANDS, Choice, is_cycle
from hilbench.diagnosis.terms import Term
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.diagnosis.web_line.on_measured_motion import LineOnMeasuredMotion
from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.plant.effect import Effect, MachineSizes, Section
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry, per_item
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.inverse import required_torque_Nm as required_torque_Nm
from hilbench.plant.web_line.layout import pack as pack
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.topology.config import BenchConfig

ENTRY: Final = EffectEntry
#: What is believed of an effect that `model_errors` has no word on: so many of its usual sizes.
WIDE: Final = 10.0


def write_effect(
    model: ModelParameters,
    parameters: Array,
    effect: Effect,
    axis: int | None,
    slot: int,
    values: dict[str, float],
    section: Section | None,
) -> None:
    """Write an effect's values into a parameter vector; others stay."""
    if isinstance(section, str):
        lay.write_station_effect(parameters, model, effect.id, section, values)
    else:
        lay.write_effect(parameters, effect.id, axis, slot, values, span=section)


def sizes(
    model: ModelParameters, axis: int | None, top_speed: float, torque_Nm: float, sample_time_s: float | None
) -> MachineSizes:
    """Usual sizes at an axis."""
    return machine_sizes(model, axis, top_speed_m_s=top_speed, torque_Nm=torque_Nm, sample_time_s=sample_time_s)


def turns_apart(model: ModelParameters, axis: int) -> bool:
    """True if a play can be between motor and roller: with a web there has to be inertia on both sides of it."""
    return is_lone(model) or (model.motor_mass_kg(axis) > 0.0 and model.roller_mass_kg(axis) > 0.0)


def Nm_per_acceleration(model: ModelParameters, axis: int) -> float:
    """Torque at the motor that accelerates an axis with what it drives, per m/s²."""
    return (model.motor_mass_kg(axis) + model.roller_mass_kg(axis)) / model.motor_rad_per_m(axis)


def choice(model: ModelParameters, data: Measured, emulation: AnyEmulation | None) -> Choice:
    """A free run where the drives' loops are those of the model, or are not seen; else on measured motion."""
    if model.web is None:
        return Choice(OnMeasuredMotion(model, data), "measured motion of a lone axis")
    commands = RECORDED_COMMANDS
    if data.emulated:
        given = emulation if isinstance(emulation, Emulation) else None
        of_web = given or Emulation.usual(model, data.period_s)
        if not is_cycle(data.period_s / of_web.cycle_s):
            return Choice(FreeRun(model, data), commands)
        return Choice(FreeRun(model, data, of_web), commands)
    if not set(data.x_m) | set(data.v_m_s) >= set(range(1, model.axis_count + 1)):
        return Choice(FreeRun(model, data), commands)
    motion = LineOnMeasuredMotion(model, data)
    loops = motion.loops()
    if not data.commands_m_s.size:
        return Choice(motion, f"measured motion: there are no commands{_blind(motion)}")
    if loops and all(loop.is_known for loop in loops):
        return Choice(FreeRun(model, data), commands, loops)
    why = "the drives' loops are not those of the model" if loops else "the drives' loops are not identifiable"
    if motion.knows_strain or len(data.tau_Nm) == model.axis_count:
        # A torque that is recorded late looks like a lag of its loop; what moves by the model's loops has them.
        only_late = bool(loops) and all(loop.is_known or loop.is_only_late(model) for loop in loops)
        simpler = Choice(FreeRun(model, data), commands) if only_late else None
        return Choice(motion, f"measured motion: {why}{_blind(motion)}", loops, simpler)
    others = [loop for loop in loops if loop.is_understood and not loop.is_known]
    return Choice(FreeRun(model, data, loops=others), f"{commands}, with the loops that the drives show", loops)


def _blind(motion: LineOnMeasuredMotion) -> str:
    return "" if motion.knows_strain else "; without positions the strain is not observable, nor what acts on it"


def emulation(config: BenchConfig, resolution: tuple[float, ...] | None) -> Emulation:
    """Emulation by the load motors. `resolution`: m/s, of each axis's velocity command."""
    return Emulation(config.cycle_time_s, config.rig_parameters().load_motors, resolution)


def believed_sizes(term: Term, model: Machine, errors: ModelErrorsConfig, modulus_share: float) -> dict[str, float]:
    """Standard deviations of strengths at the axis of a term before anything is measured, by effect: as a twin believes
    them; of E `modulus_share`, relative."""
    if not isinstance(model, ModelParameters):
        return {}
    axis, boundary = term.axis or 1, model.boundary
    tension_N = max(boundary.upstream_tension_N, boundary.downstream_tension_N)
    strain = tension_N / model.stiffness_N(1)
    limit_Nm = per_item(model.drives.torque_limit_Nm, axis) if model.drives else WIDE * term.size
    friction_N = 0.01 * errors.friction_pct * tension_N
    return {
        "coulomb_friction": friction_N,
        "viscous_friction": friction_N / errors.at_speed_m_s,
        "torque_offset": 0.01 * errors.torque_offset_pct * limit_Nm,
        "strain_offset": 0.01 * errors.strain_pct * strain,
        "web_slip": 0.01 * errors.creep_pct / model.stiffness_N(1),
        "roller_eccentricity": 1e-6 * errors.eccentricity_um,
        "unbalance": 0.01 * errors.unbalance_pct * tension_N * model.radius_m(axis),
        "elasticity_shift": modulus_share,
    }
