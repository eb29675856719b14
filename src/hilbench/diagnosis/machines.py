"""The model of a machine of any kind, as a diagnosis varies it: its parameter vector, effects, and channels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.plant.effect import Domain, Effect, MachineKind, MachineSizes, Section
from hilbench.plant.effects import STATION_EFFECTS, effects_of, find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.servo_axis import layout as shaft_layout
from hilbench.plant.servo_axis import sizes as shaft_sizes
from hilbench.plant.servo_axis.effects import ShaftEffect
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.servo_axis.inverse import required_torque_Nm as shaft_torque_Nm
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.plant.web_line.sizes import machine_sizes

Array = NDArray[np.float64]
#: How a bench emulated a machine with its load motors.
AnyEmulation = Emulation | ShaftEmulation

#: The unit of a speed, in a channel's name and as a person writes it, by that of the position.
_RATES: Final = {"m": ("m_s", "m/s"), "rad": ("rad_s", "rad/s")}


def is_lone(model: Machine) -> bool:
    """True if it is a lone axis, without a web."""
    return model.span_count == 0


def kind_of(model: Machine) -> MachineKind:
    """By whose rows its effects are."""
    return model.machine_kind


def vocabulary(model: Machine) -> tuple[Effect, ...]:
    """Effects that it may lack."""
    return effects_of(kind_of(model)) + (STATION_EFFECTS if has_stations(model) else ())


def has_stations(model: Machine) -> bool:
    """True if it has stations in addition to driven axes and spans."""
    return not isinstance(model, ServoAxisParameters) and model.stations is not None


def position_channel(model: Machine, axis: int) -> str:
    """Position channel of a recording, in the machine's unit."""
    return f"x{axis}_{model.position_unit}"


def speed_channel(model: Machine, axis: int, what: str = "") -> str:
    """Speed channel of a recording; `what`: "_cmd" of a command."""
    return f"v{axis}{what}_{_RATES[model.position_unit][0]}"


def speed_unit(model: Machine) -> str:
    """Unit of speed as written in messages."""
    return _RATES[model.position_unit][1]


def pack(model: Machine) -> Array:
    """The kernel's parameter vector."""
    return shaft_layout.pack(model) if isinstance(model, ServoAxisParameters) else lay.pack(model)


def write_effect(
    model: Machine,
    parameters: Array,
    effect: Effect,
    axis: int | None,
    slot: int,
    values: dict[str, float],
    *,
    section: Section | None = None,
) -> None:
    """Write an effect's values, by name, into a parameter vector of the machine's kernel; others stay.

    section: None for all of them.
    """
    if isinstance(model, ServoAxisParameters):
        for number, parameter in enumerate(effect.parameters):
            if parameter.name in values:
                parameters[shaft_layout.place(effect.id, number, slot)] = values[parameter.name]
        return
    if isinstance(section, str):
        lay.write_station_effect(parameters, model, effect.id, section, values)
    else:
        lay.write_effect(parameters, effect.id, axis, slot, values, span=section)


def with_effects(model: Machine, entries: Sequence[EffectEntry]) -> Machine:
    """The model with these effects instead of its own, validated. Raises pydantic.ValidationError."""
    data = model.model_dump()
    data["effects"] = [entry.model_dump() for entry in entries]
    return type(model).model_validate(data)


def entry(
    model: Machine, effect_id: str, axis: int | None, parameters: Mapping[str, float], section: Section | None = None
) -> EffectEntry:
    """Entry of an effect in the model's file."""
    made = ShaftEffect if isinstance(model, ServoAxisParameters) else EffectEntry
    if isinstance(section, str):
        return made(effect=effect_id, station=section, parameters=dict(parameters))
    return made(effect=effect_id, axis=axis, span=section, parameters=dict(parameters))


def places(model: Machine, effect: Effect) -> list[tuple[int | None, Section | None]]:
    """Axes, spans and stations at which a model may have an effect.

    What a span has by itself is in each of several; of the web it may as well be in all of them (None), as a property
    of what runs through. In the only span it has no number.
    """
    if effect.per_axis:
        return [(axis, None) for axis in range(1, model.axis_count + 1)]
    if effect.stations:
        stations = {} if isinstance(model, ServoAxisParameters) else model.station_types
        return [(None, name) for name, kind in stations.items() if kind in effect.stations]
    if not effect.per_section or model.span_count < 2:
        return [(None, None)]
    single: list[tuple[int | None, Section | None]] = [(None, section) for section in range(1, model.span_count + 1)]
    return [*single, (None, None)] if effect.domain is Domain.ELASTICITY else single


def entries_at(model: Machine, effect: Effect, axis: int | None, section: Section | None) -> list[EffectEntry]:
    """Entries of an effect at a place in a model, in the order of its slots."""
    return [
        one
        for one in model.effects
        if one.effect == effect.id
        and (not effect.per_axis or one.axis == axis)
        and (section is None or one.section in (None, section))
    ]


def effect_of(model: Machine, effect_id: str) -> Effect:
    """The row as the machine has it. Raises KeyError."""
    return find_effect(effect_id, kind_of(model))


def sizes(
    model: Machine, axis: int | None, top_speed: float, torque_Nm: float, sample_time_s: float | None
) -> MachineSizes:
    """Usual sizes at an axis; `top_speed` in the machine's unit."""
    if isinstance(model, ServoAxisParameters):
        return shaft_sizes.machine_sizes(
            model, top_speed_rad_s=top_speed, torque_Nm=torque_Nm, sample_time_s=sample_time_s
        )
    return machine_sizes(model, axis, top_speed_m_s=top_speed, torque_Nm=torque_Nm, sample_time_s=sample_time_s)


def without_unbalance(parameters: Array) -> Array:
    """The parameter vector of a servo axis with nothing unbalanced."""
    balanced = parameters.copy()
    balanced[[shaft_layout.P_UNBALANCE, shaft_layout.place("unbalance")]] = 0.0
    return balanced


def turns_apart(model: Machine, axis: int) -> bool:
    """True if a play can be between motor and roller: with a web there has to be inertia on both sides of it."""
    if isinstance(model, ServoAxisParameters):
        return False
    if is_lone(model):
        return True
    return model.motor_mass_kg(axis) > 0.0 and model.roller_mass_kg(axis) > 0.0


def Nm_per_acceleration(model: Machine, axis: int) -> float:
    """Torque at the motor that accelerates an axis with what it drives, per m/s² (rad/s² of a rotary machine)."""
    if isinstance(model, ServoAxisParameters):
        return model.inertia_kg_m2
    return (model.motor_mass_kg(axis) + model.roller_mass_kg(axis)) / model.motor_rad_per_m(axis)


def required_Nm(
    model: Machine,
    parameters: Array,
    x: Array,
    v: Array,
    a: Array,
    period_s: float,
    out: Array,
    presliding: float = 0.0,
) -> None:
    """Torque (n,) that a motion (n,) of a lone axis needs, into `out`: as its drive reports it.

    presliding: displacement over which dry friction turns over after a reversal, in the machine's unit.
    """
    law = shaft_torque_Nm if isinstance(model, ServoAxisParameters) else required_torque_Nm
    law(parameters, x, v, a, period_s, out, presliding)
