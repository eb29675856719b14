"""Metrics from the findings of the diagnosis beside a run, which criteria can bound.

``found.EFFECT[.axisN|.spanN].FIGURE`` is a figure of the first time that the effect was found there (without a span:
in whichever), ``gone.EFFECT[.axisN|.spanN].FIGURE`` of the first time that it was found to have gone again; a figure is
one of `_FIGURES`, or a parameter of the effect.
``found.count`` is how many effects were found, for runs in which there is nothing to be found.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final

from hilbench.bench.reports.diagnosis_updates import FoundEffect, ModelChange
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import find_effect
from hilbench.runs.segment import Metric

COUNT: Final = "found.count"
_NAME: Final = re.compile(r"(found|gone)\.([a-z_]+)(?:\.([a-z]+)[1-9]\d{0,3})?\.(\w+)")
_NOT_FOUND: Final = "it was not found, or no live diagnosis ran"
#: Unit and meaning of what is known of every effect that was found.
_FIGURES: Final[Mapping[str, tuple[str, str]]] = {
    "t_s": ("s", "since when model and measurement parted"),
    "named_after_s": ("s", "from then until it was named"),
    "applied_after_s": ("s", "from then until the twin had switched to the changed model"),
    "tension_step_N": ("N", "largest change of a simulated tension from one cycle to the next on the way"),
    "gap_before_Nm": ("N·m", "rms of measured less predicted torque, means over ten cycles, before, in the trial"),
    "gap_after_Nm": ("N·m", "the same after"),
    "gap_over_noise": ("", "the same after, over the noise floor"),
}
METRICS: Final[Mapping[str, Metric]] = {
    COUNT: Metric("", "effects that were found while the bench ran", "no live diagnosis ran")
}
#: The others, as they are shown to a person.
FIGURES: Final[Mapping[str, Metric]] = {
    f"found.EFFECT.axisN.{name}": Metric(unit, meaning, _NOT_FOUND) for name, (unit, meaning) in _FIGURES.items()
}


def find_metric(name: str, kinds: Sequence[MachineKind] = tuple(MachineKind)) -> Metric | None:
    """Metric of a name, for one of these kinds of machine; None for one that is no metric of what was found."""
    if name in METRICS:
        return METRICS[name]
    parts = _NAME.fullmatch(name)
    if parts is None:
        return None
    _, effect_id, part, figure = parts.groups()
    for kind in kinds:
        with suppress(KeyError):
            effect = find_effect(effect_id, kind)
            if part != effect.part and (part is not None or effect.per_axis):
                continue
            if figure in _FIGURES:
                return Metric(*_FIGURES[figure], _NOT_FOUND)
            return Metric(effect.parameter(figure).unit, f"{figure} of {effect_id} as it was found", _NOT_FOUND)
    return None


def metrics(changes: Sequence[ModelChange]) -> dict[str, float | None]:
    """Metrics of everything that was found in a run."""
    found: dict[str, float | None] = {COUNT: float(sum(len(change.effects) for change in changes))}
    for change in changes:
        for kind, effects in (("found", change.effects), ("gone", change.gone)):
            for effect in effects:
                names = [effect.place] if effect.axis is not None else [effect.place, effect.effect]
                for figure, value in _figures(change, effect).items():
                    for name in names:
                        found.setdefault(f"{kind}.{name}.{figure}", value)
    return found


def _figures(change: ModelChange, effect: FoundEffect) -> dict[str, float | None]:
    gap = change.gap
    return {
        "t_s": change.begun_s,
        "named_after_s": change.named_after_s,
        "applied_after_s": change.applied_after_s,
        "tension_step_N": change.tension_step_N,
        "gap_before_Nm": None if gap is None else gap.before,
        "gap_after_Nm": None if gap is None else gap.after,
        "gap_over_noise": None if gap is None else gap.after / gap.noise_floor,
        **{name: each.value for name, each in effect.parameters.items()},
    }
