"""Models of a line with another E, or without what the twin estimates."""

from __future__ import annotations

from hilbench.live.models import with_entries
from hilbench.plant.effect import Domain
from hilbench.plant.effects import find_effect
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters

_SHIFT = "elasticity_shift"


def is_of_estimate(effect_id: str) -> bool:
    """Whether an effect is a change of what the twin estimates anyway."""
    effect = find_effect(effect_id)
    return effect.domain is Domain.ELASTICITY and effect_id not in ("web_damping", "strain_offset")


def with_modulus(model: ModelParameters, youngs_modulus_Pa: float) -> ModelParameters:
    """The model with another E in its spans; what is around them stays."""
    share = youngs_modulus_Pa / model.youngs_modulus_Pa(1) - 1.0
    kept = [entry for entry in model.effects if entry.effect != _SHIFT]
    return with_entries(model, [*kept, EffectEntry(effect=_SHIFT, parameters={"relative_change": share})])


def line(model: Machine) -> ModelParameters:
    """The same, known to be of a line."""
    assert isinstance(model, ModelParameters), "a line is diagnosed as one"
    return model


def modulus_at(model: Machine, time_s: float) -> float:
    """E of the web as the model's effects make it at a time of theirs, Pa."""
    p = lay.pack(line(model))
    row = lay.Layout.of(p).first_span
    steps = laws.step_factor(p, row, time_s, float(p[lay.W_SAMPLE_TIME_S]))
    return float(p[row + lay.SP_MODULUS_PA] * laws.elasticity_factor(p, row, time_s, steps))


def without_estimate(model: Machine, configured: ModelParameters) -> ModelParameters:
    """The model without changes of E but for those that it was configured with."""
    model = line(model)
    entries = [entry for entry in model.effects if not is_of_estimate(entry.effect)]
    own = [entry for entry in configured.effects if is_of_estimate(entry.effect)]
    return with_entries(model, [*own, *entries])
