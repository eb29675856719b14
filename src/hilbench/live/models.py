"""Models of a machine that differ in their effects alone: what the twin has, what it could have."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TypeVar, cast

from hilbench.bench.reports.found import FoundEffect, FoundValue
from hilbench.diagnosis.diagnosis import NamedEffect
from hilbench.plant.effect import MachineKind, ProbeOver
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry

Model = TypeVar("Model", bound=Machine)

#: Effects that begin at a time, or swing with it, by a clock that a window and a twin do not share.
_BY_THE_CLOCK = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION, ProbeOver.PASSAGE)


def can_be_carried(effect_id: str, kind: MachineKind) -> bool:
    """Whether it means the same in the twin as in a window of data."""
    probe = find_effect(effect_id, kind).probe
    return probe is None or probe.over not in _BY_THE_CLOCK


def with_entries(model: Model, entries: Sequence[EffectEntry]) -> Model:
    """The model with these effects in the place of its own."""
    data = model.model_dump()
    data["effects"] = [entry.model_dump() for entry in entries]
    return cast("Model", type(model).model_validate(data))


def as_text(model: Machine, configured: Machine) -> str:
    """Effects as the twin reads them; "" for those that it was configured with."""
    if model.effects == configured.effects:
        return ""
    return json.dumps([entry.model_dump() for entry in model.effects], separators=(",", ":"))


def found_effect(named: NamedEffect, kind: MachineKind) -> FoundEffect:
    """As it is told to the bench."""
    values = {
        name: FoundValue(value.value, value.ci95[0], value.ci95[1], value.unit)
        for name, value in named.parameters.items()
    }
    span = 1 if find_effect(named.effect, kind).per_section else None
    return FoundEffect(named.effect, named.axis, span, values, tuple(named.tied_with))


def of_entry(entry: EffectEntry, kind: MachineKind) -> FoundEffect:
    """An effect of a model, whose values are what they are."""
    effect = find_effect(entry.effect, kind)
    values = {
        name: FoundValue(value, value, value, effect.parameter(name).unit) for name, value in entry.parameters.items()
    }
    return FoundEffect(entry.effect, entry.axis, 1 if effect.per_section else None, values)
