"""Models of a machine that differ in their effects alone: what the twin has, what it could have."""

from __future__ import annotations

import json

from hilbench.bench.reports.diagnosis_updates import FoundEffect, FoundValue
from hilbench.diagnosis.diagnosis import NamedEffect
from hilbench.plant.effect import Effect, MachineKind, ProbeOver, Section
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry

#: Effects that begin at a time, or swing with it, by a clock that a window and a twin do not share.
_BY_THE_CLOCK = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION, ProbeOver.PASSAGE)


def why_not_carried(effect_id: str, kind: MachineKind) -> str:
    """Why it does not mean the same in a twin as in a window of data; "" where it does."""
    probe = find_effect(effect_id, kind).probe
    by_the_clock = probe is not None and probe.over in _BY_THE_CLOCK
    return "it goes by a clock that the twin does not have" if by_the_clock else ""


def as_text(model: Machine, configured: Machine) -> str:
    """Effects as the twin reads them; "" for those that it was configured with."""
    if model.effects == configured.effects:
        return ""
    return json.dumps([entry.model_dump() for entry in model.effects], separators=(",", ":"))


def found_effect(named: NamedEffect, model: Machine) -> FoundEffect:
    """Effect that a model lacks, as reported to the bench."""
    values = {name: FoundValue(value.value, value.ci95, value.unit) for name, value in named.parameters.items()}
    section = _section(find_effect(named.effect, model.machine_kind), named.section, model)
    return FoundEffect(named.effect, named.axis, section, values, tuple(named.tied_with))


def of_entry(entry: EffectEntry, model: Machine) -> FoundEffect:
    """An effect of a model, whose values are what they are."""
    effect = find_effect(entry.effect, model.machine_kind)
    values = {
        name: FoundValue(value, (value, value), effect.parameter(name).unit) for name, value in entry.parameters.items()
    }
    return FoundEffect(entry.effect, entry.axis, _section(effect, entry.section, model), values)


def _section(effect: Effect, section: Section | None, model: Machine) -> int | None:
    """The number of the section that an effect is in: of the only one 1, None for one that is in all of them."""
    if not effect.per_section:
        return None
    return 1 if model.span_count == 1 else section if isinstance(section, int) else None
