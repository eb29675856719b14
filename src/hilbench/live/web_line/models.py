"""Models of a line with another E, or without what the twin estimates."""

from __future__ import annotations

from collections.abc import Mapping

from hilbench.live.models import with_entries
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters

_SHIFT, _SHARE = "elasticity_shift", "relative_change"


def is_of_estimate(effect_id: str) -> bool:
    """True if an effect is a change of what the twin estimates anyway."""
    effect = find_effect(effect_id)
    return effect.domain is Domain.ELASTICITY and effect_id not in ("web_damping", "strain_offset")


def with_moduli(model: ModelParameters, moduli_Pa: Mapping[int, float]) -> ModelParameters:
    """The model with another E in its spans, by their numbers from 1; what is around them stays."""
    shares: dict[int, float] = {}
    for entry in model.effects:
        if entry.effect == _SHIFT:
            spans = range(1, model.span_count + 1) if entry.span is None else (entry.span,)
            shares |= dict.fromkeys(spans, entry.parameters[_SHARE])
    shares |= {span: modulus_Pa / model.youngs_modulus_Pa(span) - 1.0 for span, modulus_Pa in moduli_Pa.items()}
    kept = [entry for entry in model.effects if entry.effect != _SHIFT]
    shifts = [
        EffectEntry(effect=_SHIFT, span=span if model.span_count > 1 else None, parameters={_SHARE: share})
        for span, share in shares.items()
    ]
    return with_entries(model, [*kept, *shifts])


def numbered(model: ModelParameters, span: int) -> str:
    """Number of a span in names of signals: empty where there is only one."""
    return str(span) if model.span_count > 1 else ""


def line(model: Machine) -> ModelParameters:
    """Narrow a machine's type to a web line."""
    assert isinstance(model, ModelParameters), "a line is diagnosed as one"
    return model


def modulus_at(model: Machine, span: int, time_s: float) -> float:
    """E of the web in a span as the model's effects make it at a time of theirs, Pa."""
    p = lay.pack(line(model))
    row = lay.Layout.of(p).first_span + (span - 1) * lay.SP_SIZE
    steps = laws.step_factor(p, row, time_s, float(p[lay.W_SAMPLE_TIME_S]))
    return float(p[row + lay.SP_MODULUS_PA] * laws.elasticity_factor(p, row, time_s, steps))


def without_estimate(model: Machine, configured: ModelParameters) -> ModelParameters:
    """The model without changes of E but for those that it was configured with."""
    model = line(model)
    entries = [entry for entry in model.effects if not is_of_estimate(entry.effect)]
    own = [entry for entry in configured.effects if is_of_estimate(entry.effect)]
    return with_entries(model, [*own, *entries])
