"""The quantities of a running bench that an experiment may change, by path.

`line_speed_m_s`, `tension_control.set_point_N`, `load.web.youngs_modulus_Pa`, `load.web.broken` (1: the web of the span
has torn and pulls no more; 0: it is whole), and any parameter of any effect, hidden
in the imitated mechanics or in the simulated hardware: `load.effects.elasticity_drift.rate_per_s`,
`hardware.effects.coulomb_friction.axis1.force_N`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from hilbench.suggest import did_you_mean
from hilbench.web.effects import EFFECTS, find_effect

LINE_SPEED = "line_speed_m_s"
TENSION_SET_POINT = "tension_control.set_point_N"
YOUNGS_MODULUS = "load.web.youngs_modulus_Pa"
WEB_BROKEN = "load.web.broken"

PLAIN_PATHS = (LINE_SPEED, TENSION_SET_POINT, YOUNGS_MODULUS, WEB_BROKEN)


@dataclass(frozen=True)
class EffectPath:
    """One parameter of one effect, in the imitated mechanics (`load`) or the simulated `hardware`."""

    place: str
    effect: str
    axis: int | None
    parameter: str


def parse_effect_path(text: str) -> EffectPath:
    """Take ``load|hardware.effects.ID[.axis1|.axis2].PARAMETER`` apart. Raises ValueError that says what is wrong."""
    parts = text.split(".")
    if len(parts) not in (4, 5) or parts[0] not in ("load", "hardware") or parts[1] != "effects":
        known = ", ".join(PLAIN_PATHS)
        raise ValueError(
            f"one of {known}, or load|hardware.effects.ID[.axisN].PARAMETER{did_you_mean(text, _all_paths())}"
        )
    place, _, name, *axis_part, parameter = parts
    try:
        effect = find_effect(name)
    except KeyError:
        meant = did_you_mean(name, (effect.id for effect in EFFECTS))
        raise ValueError(f"an effect of the vocabulary, '{name}' is none{meant}") from None
    axis = {"axis1": 1, "axis2": 2}.get(axis_part[0]) if axis_part else None
    if effect.per_axis and axis is None:
        raise ValueError(f"'{name}' with its axis: {place}.effects.{name}.axis1|axis2.{parameter}")
    if not effect.per_axis and axis_part:
        raise ValueError(f"'{name}' without an axis: {place}.effects.{name}.{parameter}")
    names = [known.name for known in effect.parameters]
    if parameter not in names:
        meant = did_you_mean(parameter, names)
        raise ValueError(f"a parameter of '{name}' ({', '.join(names)}), '{parameter}' is none{meant}")
    return EffectPath(place, name, axis, parameter)


def _all_paths() -> Iterator[str]:
    yield from PLAIN_PATHS
    for effect in EFFECTS:
        axes = ("axis1.", "axis2.") if effect.per_axis else ("",)
        for place, axis, parameter in product(("load", "hardware"), axes, effect.parameters):
            yield f"{place}.effects.{effect.id}.{axis}{parameter.name}"


def is_of_load(path: str) -> bool:
    """Whether a quantity belongs to the imitated mechanics."""
    return path.startswith("load.")


def settable_path(text: str) -> str:
    """The path itself when it names a quantity that can be set; ValueError otherwise."""
    if text not in PLAIN_PATHS:
        parse_effect_path(text)
    return text
