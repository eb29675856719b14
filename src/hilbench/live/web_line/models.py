"""Models of a line that differ in their effects alone: what the twin has, what it could have."""

from __future__ import annotations

import json
from collections.abc import Sequence

from hilbench.bench.reports.found import FoundEffect, FoundValue
from hilbench.diagnosis.diagnosis import NamedEffect
from hilbench.plant.effect import Domain, ProbeOver
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters

_SHIFT = "elasticity_shift"
#: Effects that begin at a time, or swing with it, by a clock that a window and a twin do not share.
_BY_THE_CLOCK = (ProbeOver.TIME, ProbeOver.ONSET, ProbeOver.ONSET_AND_DURATION, ProbeOver.PASSAGE)


def is_of_estimate(effect_id: str) -> bool:
    """Whether an effect is a change of what the twin estimates anyway."""
    effect = find_effect(effect_id)
    return effect.domain is Domain.ELASTICITY and effect_id not in ("web_damping", "strain_offset")


def can_be_carried(effect_id: str) -> bool:
    """Whether it means the same in the twin as in a window of data."""
    probe = find_effect(effect_id).probe
    return probe is None or probe.over not in _BY_THE_CLOCK


def with_entries(model: ModelParameters, entries: Sequence[EffectEntry]) -> ModelParameters:
    """The model with these effects in the place of its own."""
    data = model.model_dump()
    data["effects"] = [entry.model_dump() for entry in entries]
    return ModelParameters.model_validate(data)


def with_modulus(model: ModelParameters, youngs_modulus_Pa: float) -> ModelParameters:
    """The model with another E in its spans; what is around them stays."""
    share = youngs_modulus_Pa / model.youngs_modulus_Pa(1) - 1.0
    kept = [entry for entry in model.effects if entry.effect != _SHIFT]
    return with_entries(model, [*kept, EffectEntry(effect=_SHIFT, parameters={"relative_change": share})])


def _line(model: Machine) -> ModelParameters:
    assert isinstance(model, ModelParameters), "a line is diagnosed as one"
    return model


def modulus_at(model: Machine, time_s: float) -> float:
    """E of the web as the model's effects make it at a time of theirs, Pa."""
    p = lay.pack(_line(model))
    row = lay.Layout.of(p).first_span
    steps = laws.step_factor(p, row, time_s, float(p[lay.W_SAMPLE_TIME_S]))
    return float(p[row + lay.SP_MODULUS_PA] * laws.elasticity_factor(p, row, time_s, steps))


def without_estimate(model: Machine, configured: ModelParameters) -> ModelParameters:
    """The model without changes of E but for those that it was configured with."""
    model = _line(model)
    entries = [entry for entry in model.effects if not is_of_estimate(entry.effect)]
    own = [entry for entry in configured.effects if is_of_estimate(entry.effect)]
    return with_entries(model, [*own, *entries])


def as_text(model: ModelParameters, configured: ModelParameters) -> str:
    """Effects as the twin reads them; "" for those that it was configured with."""
    if model.effects == configured.effects:
        return ""
    return json.dumps([entry.model_dump() for entry in model.effects], separators=(",", ":"))


def found_effect(named: NamedEffect) -> FoundEffect:
    """As it is told to the bench."""
    values = {
        name: FoundValue(value.value, value.ci95[0], value.ci95[1], value.unit)
        for name, value in named.parameters.items()
    }
    span = 1 if find_effect(named.effect).per_section else None
    return FoundEffect(named.effect, named.axis, span, values, tuple(named.tied_with))


def of_entry(entry: EffectEntry) -> FoundEffect:
    """An effect of a model, whose values are what they are."""
    effect = find_effect(entry.effect)
    values = {
        name: FoundValue(value, value, value, effect.parameter(name).unit) for name, value in entry.parameters.items()
    }
    return FoundEffect(entry.effect, entry.axis, 1 if effect.per_section else None, values)
