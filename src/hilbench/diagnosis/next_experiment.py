"""The next experiment: of a small library of moves the one, or two, that identify most of what is tied or not
shown. What a move identifies depends on the kind of machine: `web_next_experiment`, `axis_next_experiment`."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench import strict_yaml
from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect
from hilbench.diagnosis.terms import Place
from hilbench.files import write_whole
from hilbench.plant.effect import MachineSizes
from hilbench.plant.effects import EFFECTS
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry

Array = NDArray[np.float64]
Step = dict[str, dict[str, Any]]

#: Longest experiment that is proposed, s.
LONGEST_S: Final = 30.0
#: Fall of the sum of squares from which two explanations are told apart, and of an effect from which it is visible.
_APART, _VISIBLE = 50.0, 25.0
#: How often over that a move need not be better, and weight of what is tied over what was not shown.
_ENOUGH, _TIE = 100.0, 20.0
#: How long a usual ramp takes, and over what time a steep one is looked for in what the machine has done, s.
RAMP_S, STEEP_S = 1.5, 0.2
#: Every experiment begins with it, s.
START_S: Final = 0.5


@dataclass(frozen=True)
class NextExperiment:
    """Steps from standstill to standstill, and why these."""

    steps: list[Step]
    moves: str  #: what they are, for a person
    reasons: list[str]  #: one line for each thing that they would tell
    duration_s: float


@dataclass(frozen=True)
class Question:
    """Something that is not known: an effect that may be another, or one that could not be seen."""

    text: str
    with_it: Machine
    without: Machine
    instead: list[Machine]  #: `without`, and some of the other effect
    least: float
    weight: float

    @property
    def models(self) -> list[Machine]:
        """All of them, in this order."""
        return [self.with_it, self.without, *self.instead]

    def is_identified(self, predicted: Array) -> float:
        """By predictions (models, n), in units of the noise: how far they lie apart, squared, with the other effect
        fitted."""
        with_it, without, *instead = predicted
        response = with_it - without
        if instead:
            other = np.array(instead) - without
            theta, *_ = np.linalg.lstsq(other.T, response, rcond=1e-10)
            response = response - theta @ other
        return float(response @ response) if np.all(np.isfinite(response)) else 0.0


def hold(duration_s: float) -> Step:
    """Nothing changes for a time."""
    return {"hold": {"duration_s": round(duration_s, 3)}}


def through(
    path: str, top: float, steepest: float, levels: Sequence[tuple[float, float, float]], last: Sequence[Step] = ()
) -> list[Step]:
    """Steps through levels of a speed to standstill: share of the top speed, least time to it, time at it, s.

    path: of the speed; top and steepest: its highest value and rate. last: steps before the ramp to standstill.
    """
    steps: list[Step] = []
    speed = 0.0
    for share, least_s, stay_s in [*levels, (0.0, RAMP_S, 0.5)]:
        to = share * top
        if share == 0.0:
            steps += last
        takes_s = max(least_s, STEEP_S, abs(to - speed) / steepest)
        steps += [{"ramp": {"path": path, "to": round(to, 4), "duration_s": round(takes_s + 5e-4, 3)}}, hold(stay_s)]
        speed = to
    return steps


def duration_s(steps: Sequence[Step]) -> float:
    """Duration of steps, s."""
    return float(sum(one.get("duration_s", 0.0) for step in steps for one in step.values()))


def best(
    library: Mapping[str, list[Step]], questions: Sequence[Question], is_identified: Callable[[list[Step]], Array]
) -> NextExperiment | None:
    """The move, or two, that would answer most of the questions; None where no move answers any.

    library: moves from standstill to standstill, by name. is_identified: which questions (questions,) steps answer,
    as `Question.is_identified`.
    """
    if not questions:
        return None
    library = {name: steps for name, steps in library.items() if _takes({name: steps}, (name,)) <= LONGEST_S}
    options: list[tuple[str, ...]] = [(name,) for name in library]
    options += [pair for pair in combinations(library, 2) if _takes(library, pair) <= LONGEST_S]
    of_move = {name: is_identified([hold(START_S), *steps]) for name, steps in library.items()}
    chosen, score = None, 0.0
    for names in options:
        # What moves tell adds up; longer ones have to tell more.
        gains = np.sum([of_move[name] for name in names], axis=0)
        value = sum(q.weight * np.log1p(min(g / q.least, _ENOUGH)) for q, g in zip(questions, gains, strict=True))
        value *= 1.0 - 0.01 * _takes(library, names)
        if value > score and any(g > q.least for q, g in zip(questions, gains, strict=True)):
            chosen, score = names, float(value)
    if chosen is None:
        return None
    gains = np.sum([of_move[name] for name in chosen], axis=0)
    reasons = [
        f"{q.text}: chi-square {g:.3g}, {'is_identified' if g > q.least else 'not told'} from {q.least:g} on"
        for q, g in zip(questions, gains, strict=True)
        if g > q.least or q.weight > 1.0
    ]
    steps = [hold(START_S), *(step for name in chosen for step in library[name])]
    return NextExperiment(steps, ", then ".join(chosen), reasons, duration_s(steps))


def _takes(library: Mapping[str, list[Step]], names: tuple[str, ...]) -> float:
    return START_S + sum(duration_s(library[name]) for name in names)


def questions_of(found: Diagnosis, sizes: Callable[[int | None], MachineSizes]) -> Iterator[Question]:
    """Questions that a diagnosis leaves open; `sizes`: what is usual at an axis of its machine."""
    model = found.model
    for effect in found.effects:
        entry = next((e for e in model.effects if Place.of(e) == effect.place), None)
        if entry is None:
            continue
        rest: list[EffectEntry] = list(model.effects)
        rest.remove(entry)
        without = machines.with_effects(model, rest)
        for name in effect.tied_with:
            other = _other(name, effect, model)
            if other is None:
                continue
            tries = _tries(other, without, sizes, entry)
            if not tries:
                continue
            instead = [machines.with_effects(model, [*rest, one]) for one in tries]
            yield Question(f"whether it is {effect.effect} or {name}", model, without, instead, _APART, _TIE)
    for blind in found.unobservable:
        unseen, like = machines.effect_of(model, blind.effect), None
        if blind.shape:
            like = machines.entry(model, unseen.id, blind.axis, unseen.filled(blind.shape))
        for one in _tries(blind.place, model, sizes, like)[:1]:
            with_it = machines.with_effects(model, [*model.effects, one])
            yield Question(f"whether there is {blind.place.text}", with_it, model, [], _VISIBLE, 1.0)


def _other(name: str, effect: NamedEffect, model: Machine) -> Place | None:
    """Place of an effect that is tied with another, parsed from its name; None for one outside the vocabulary."""
    match = re.fullmatch(r"(\w+)(?: \((axis|span) (\d+)\))?", name)
    if match is None or match[1] not in {one.id for one in EFFECTS}:
        return None
    known, number = machines.effect_of(model, match[1]), int(match[3]) if match[3] else None
    if known.per_axis:
        return Place(known.id, number or effect.axis or 1)
    return Place(known.id, None, number or (effect.section if known.per_section else None))


def _tries(
    place: Place, model: Machine, sizes: Callable[[int | None], MachineSizes], like: EffectEntry | None
) -> list[EffectEntry]:
    """Some of an effect at its usual size; of a wave at two phases; shaped as `like` where that has the same shape."""
    effect, axis = machines.effect_of(model, place.effect), place.axis
    values = effect.filled({} if like is None else {k: v for k, v in like.parameters.items() if k.endswith(_SHAPES)})
    if len(machines.entries_at(model, effect, axis, place.section)) >= effect.slots:
        return []
    strength = effect.parameter(effect.strength[0])
    # On a rotary axis that a model describes with a radius of 1 m, sizes in m are larger than any roller has.
    values[strength.name] = min(max(strength.size.on(sizes(axis)), strength.lower), strength.upper)
    phases = (0.0, 0.5 * np.pi) if "phase_rad" in values else (None,)
    return [
        machines.entry(model, effect.id, axis, values | ({} if p is None else {"phase_rad": p}), place.section)
        for p in phases
    ]


_SHAPES = ("order", "frequency_Hz", "time_s", "duration_s")


def write_steps(path: Path, proposed: NextExperiment, config: Path | None) -> Path:
    """Write it as an experiment of the bench of `config`, or to be included after a bench's own file.

    Raises UnusableInputError if it can't be written.
    """
    lines = [f"# {proposed.moves}, {proposed.duration_s:.1f} s; by simulation, of what the last experiment left open:"]
    lines += [f"# - {reason}" for reason in proposed.reasons]
    if config is None:
        lines.append(f"# To be run by a bench's config: include: [my_bench.yaml, {path.name}]")
    head: dict[str, Any] = {}
    if config is not None:
        above = Path(os.path.relpath(config.resolve(), path.resolve().parent)).as_posix()
        head = {"include": above, "name": f"{config.stem}_next"}
    text = strict_yaml.text_of({**head, "steps": proposed.steps, "criteria": []}, default_flow_style=None)
    write_whole(path, "\n".join([*lines, text]))
    return path
