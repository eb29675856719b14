"""The model of a machine of any kind, as a diagnosis varies it: parameter vector, effects, channels, emulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numpy as np

from hilbench.arrays import Array
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import declared_units
from hilbench.machine_kinds import machine_part
from hilbench.plant.effect import Domain, Effect, Section
from hilbench.plant.effects import STATION_EFFECTS, effects_of, find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.servo_axis import layout as shaft_layout
from hilbench.plant.servo_axis.emulated_run import ShaftEmulation
from hilbench.plant.web_line.emulation import Emulation
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role

#: How a bench emulated a machine with its load motors.
AnyEmulation = Emulation | ShaftEmulation
#: One kind of machine.
AnyMachine = TypeVar("AnyMachine", bound=Machine)

#: The unit of a speed, in a channel's name and as a person writes it, by that of the position.
_RATES: Final = {"m": ("m_s", "m/s"), "rad": ("rad_s", "rad/s")}


def of_kind(model: Machine) -> Any:
    """Description of its kind to the diagnosis: a module as `hilbench.diagnosis.servo_axis`. Raises UnusableInputError
    for a kind that brings none."""
    return machine_part(model.kind, "diagnosis")


def is_lone(model: Machine) -> bool:
    """True if it is a lone axis, without a web."""
    return model.span_count == 0


def vocabulary(model: Machine) -> tuple[Effect, ...]:
    """Effects that it may lack."""
    return effects_of(model.machine_kind) + (STATION_EFFECTS if has_stations(model) else ())


def has_stations(model: Machine) -> bool:
    """True if it has stations in addition to driven axes and spans."""
    return getattr(model, "stations", None) is not None


def position_channel(model: Machine, axis: int) -> str:
    """Position channel of a recording, in the machine's unit."""
    return f"x{axis}_{model.position_unit}"


def speed_channel(model: Machine, axis: int, what: str = "") -> str:
    """Speed channel of a recording; `what`: "_cmd" of a command."""
    return f"v{axis}{what}_{_RATES[model.position_unit][0]}"


def speed_unit(model: Machine) -> str:
    """Unit of speed as written in messages."""
    return _RATES[model.position_unit][1]


def packed(model: Machine) -> Array:
    """Parameter vector (P,) of a model."""
    return np.asarray(of_kind(model).pack(model))


def with_effects(model: AnyMachine, entries: Sequence[EffectEntry]) -> AnyMachine:
    """The model with these effects instead of its own, validated. Raises pydantic.ValidationError."""
    data = model.model_dump()
    data["effects"] = [entry.model_dump() for entry in entries]
    changed: AnyMachine = cast(Any, type(model)).model_validate(data)
    return changed


def entry(
    model: Machine, effect_id: str, axis: int | None, parameters: Mapping[str, float], section: Section | None = None
) -> EffectEntry:
    """Entry of an effect in the model's file."""
    made: type[EffectEntry] = of_kind(model).ENTRY
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
        stations: dict[str, str] = getattr(model, "station_types", {})
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
    return find_effect(effect_id, model.machine_kind)


def without_unbalance(parameters: Array) -> Array:
    """The parameter vector of a servo axis with nothing unbalanced."""
    balanced = parameters.copy()
    balanced[[shaft_layout.P_UNBALANCE, shaft_layout.place("unbalance")]] = 0.0
    return balanced


def Nm_per_acceleration(model: Machine, axis: int) -> float:
    """Torque at the motor that accelerates an axis with what it drives, per m/s² (rad/s² of a rotary machine)."""
    return float(of_kind(model).Nm_per_acceleration(model, axis))


def emulation_of(config: BenchConfig) -> AnyEmulation | None:
    """Emulation used by the bench of this config; None without a load motor. Without EDS files the drives' rounding
    is unknown."""
    machine, resolution = config.machine, None
    parts = enumerate(config.parts_of(Role.AXIS)[: len(config.drives)], 1)
    with suppress(UnusableInputError):  # a run folder that was brought here from another machine
        units = [(axis, declared_units(part)) for axis, part in parts]
        resolution = tuple(each.velocity_rad_s / machine.motor_rad_per_unit(axis) for axis, each in units)
    found: AnyEmulation | None = machine_part(machine.kind, "diagnosis").emulation(config, resolution)
    return found


def emulation_beside(recording: Path) -> AnyEmulation | None:
    """Emulation by the config in the run folder that a recording lies in; None if it lies in no run folder.

    Raises UnusableInputError for a config that can't be read.
    """
    folder = RunFolder(recording.parent)
    return emulation_of(load(folder.config)[0]) if folder.config.is_file() else None
