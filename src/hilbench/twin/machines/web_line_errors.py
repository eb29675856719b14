"""Estimated errors of a web line's model, as effects of the vocabulary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from hilbench.estimation.nuisance import Nuisance
from hilbench.plant.effects import find_effect
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.twin.estimated_errors import EstimatedModelError

#: Effect and parameter of each published error, by the estimator's name.
_EFFECTS: Final = {
    "torque_offset_Nm": ("torque_offset", "offset_Nm"),
    "dry_friction_N": ("coulomb_friction", "force_N"),
    "viscous_friction_N_s_per_m": ("viscous_friction", "coefficient_N_s_per_m"),
    "creep_per_N": ("web_slip", "creep_per_N"),
    "inertia_share": ("inertia_mismatch", "relative_change"),
    "eccentricity_m": ("roller_eccentricity", "amplitude_m"),
}
#: Effects inseparable from an error: a motor with less torque accelerates less, as a heavier roller does.
_TIED: Final = {"inertia_share": ("torque_scale",)}


def as_effects(errors: Sequence[Nuisance], model: ModelParameters, span: int) -> Iterator[EstimatedModelError]:
    """Estimated errors of a span as effects, including the model's own.

    Of a line with one span the errors are those of axis 2; after one of several they are of all rollers together.
    """
    alone = model.span_count == 1
    for error in errors:
        if error.name not in _EFFECTS:
            continue
        effect, parameter = _EFFECTS[error.name]
        of_axis = alone and find_effect(effect).per_axis
        axis = span + 1 if of_axis else None
        own = next((entry for entry in model.effects if entry.effect == effect and entry.axis == axis), None)
        if own is not None and error.name == "eccentricity_m":
            continue  # two at different angles do not add up
        of_model = 0.0 if own is None else own.parameters.get(parameter, 0.0)
        value, deviation = of_model + error.value, error.deviation
        if error.name == "inertia_share":  # of the model's mass
            value, deviation = (1.0 + of_model) * (1.0 + error.value) - 1.0, (1.0 + of_model) * deviation
        place = f"axis{axis}" if of_axis else ("web" if alone else f"span{span}")
        tied_with = _TIED.get(error.name, ())
        yield EstimatedModelError(effect, parameter, place, value, deviation, error.separable, tied_with)
