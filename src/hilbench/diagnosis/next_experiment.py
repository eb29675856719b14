"""The next experiment: of a small library of moves the one, or two, that identify most of what is tied or not shown.

Of a web machine by simulation, of a lone axis by the torque that its motion needs.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hilbench import strict_yaml
from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.terms import Place
from hilbench.diagnosis.web_line_experiment import Profile, line_signals
from hilbench.files import write_whole
from hilbench.plant.effect import MachineSizes
from hilbench.plant.effects import EFFECTS
from hilbench.plant.model_file import Machine
from hilbench.plant.parameters import EffectEntry
from hilbench.results.recording import Recording

Step = dict[str, dict[str, Any]]

#: Longest experiment that is proposed, s.
LONGEST_S: Final = 30.0
#: Fall of the sum of squares from which two explanations are distinguished, and of an effect from which it is visible.
_APART, _VISIBLE = 50.0, 25.0
#: How often over that a move need not be better, and weight of what is tied over what was not shown.
_ENOUGH, _TIE = 100.0, 20.0
#: How long a usual ramp takes, and over what time a steep one is looked for in what the machine has done, s.
RAMP_S, STEEP_S = 1.5, 0.2
#: Every experiment begins with it, s.
START_S: Final = 0.5
#: Paths of the speed, by the unit of a lone axis' position, and of the tension.
_SPEED: Final = {"rad": "speed_rad_s", "m": "line_speed_m_s"}
_TENSION: Final = "tension_control.set_point_N"
#: Period with which moves are simulated, s; how long a drive takes to follow a corner of its command, s.
_PERIOD_S, _FOLLOWS_S = 0.002, 0.01
#: Share of the top speed below which a lone axis is at rest, where dry friction is not one law but many; what is left
#: on its measured motion is not white: so far apart are samples that count as one each, s.
_STANDSTILL, _APART_S = 0.01, 0.05
#: Levels of a speed that a move goes through: share of the top speed, least time to it, time at it, s.
_Levels = Sequence[tuple[float, float, float]]
_SLOWLY: Final = [(share, 0.5, 1.5) for share in (0.08, -0.08) * 2]
_OF_A_LINE: Final[Mapping[str, _Levels]] = {
    "slowly forward and back": _SLOWLY,
    "levels of speed": [(share, RAMP_S, 2.0) for share in (0.25, 0.5, 0.75, 1.0)],
    "creep": [(0.02, 0.6, 4.0), (0.1, 0.6, 3.0), (0.3, 0.6, 2.0)],
    "steep ramps": [(0.4, RAMP_S, 1.0), *((share, 0.0, 1.0) for share in (0.7, 0.4) * 3)],
}
_OF_AN_AXIS: Final[Mapping[str, _Levels]] = {
    "forward and back": [(share, RAMP_S, 1.5) for share in (0.5, -0.5)],
    "slowly forward and back": _SLOWLY,
    "levels of speed in both directions": [
        (sign * share, RAMP_S, 0.8) for sign in (1.0, -1.0) for share in (0.25, 0.5, 0.75, 1.0)
    ],
    "creep": [(0.02, 0.6, 3.0), (0.1, 0.6, 2.0), (0.3, 0.6, 1.0)],
    "steep ramps": [(0.4, RAMP_S, 0.5), *((share, 0.0, 0.5) for share in (0.8, 0.4) * 3)],
    "a slow ramp": [(1.0, 10.0, 0.5)],
}


@dataclass(frozen=True)
class Reach:
    """Range that a machine has covered already, and may be asked for again; in its unit of position per s and s²."""

    top: float
    steepest: float
    tension_N: float | None = None  #: usual set point; None where none may be set
    torque_Nm: float = 1.0  #: usual, rms

    @classmethod
    def of_axis(cls, data: Measured) -> Reach:
        """Reach by the motion of a lone axis."""
        apart = max(1, round(STEEP_S / data.period_s))
        x = data.x_m[1]
        speed = (x[apart:] - x[:-apart]) / (apart * data.period_s)
        return cls(float(np.max(np.abs(speed))), _steepest(speed, apart), None, rms(data.tau_Nm[1]))

    @classmethod
    def of_line(cls, recording: Recording, axes: int = 2) -> Reach:
        """Reach by the commands of a web machine of some axes; of one span the tension is set as well."""
        speed = np.asarray(recording[f"v{axes}_cmd_m_s"], np.float64)
        apart = max(1, round(STEEP_S / float(np.median(np.diff(recording.time_s)))))
        wanted = float(np.median(np.asarray(recording["F_ref_N"], np.float64))) if "F_ref_N" in recording else 0.0
        return cls(float(np.max(np.abs(speed))), _steepest(speed, apart), wanted if wanted > 0.0 else None)


def _steepest(speed: Array, apart: int) -> float:
    """Highest rate of a speed (n,) over so many rows, which take `STEEP_S`."""
    return float(np.max(np.abs(speed[apart:] - speed[:-apart]))) / STEEP_S


@dataclass(frozen=True)
class NextExperiment:
    """Steps from standstill to standstill, and why these."""

    steps: list[Step]
    moves: str  #: what they are, for a person
    reasons: list[str]  #: one line for each thing that they would show
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
        """All models, in this order."""
        return [self.with_it, self.without, *self.instead]

    def answered_by(self, predicted: Array) -> float:
        """Information of an experiment by its predictions (models, n), in units of the noise: their distance, squared,
        with the other effect fitted."""
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


def through(path: str, reach: Reach, levels: _Levels, last: Sequence[Step] = ()) -> list[Step]:
    """Steps through levels of a speed to standstill; path: of the speed; last: steps before the ramp to standstill."""
    steps: list[Step] = []
    speed = 0.0
    for share, least_s, stay_s in [*levels, (0.0, RAMP_S, 0.5)]:
        to = share * reach.top
        if share == 0.0:
            steps += last
        takes_s = max(least_s, STEEP_S, abs(to - speed) / reach.steepest)
        steps += [{"ramp": {"path": path, "to": round(to, 4), "duration_s": round(takes_s + 5e-4, 3)}}, hold(stay_s)]
        speed = to
    return steps


def moves(reach: Reach, lone_unit: str | None = None) -> dict[str, list[Step]]:
    """The library: each move from standstill to standstill, by what it is; those that take too long are left out.

    lone_unit: unit of the position of a lone axis; None of a web machine.
    """
    path, library = (_SPEED["m"], _OF_A_LINE) if lone_unit is None else (_SPEED[lone_unit], _OF_AN_AXIS)
    found = {name: through(path, reach, levels) for name, levels in library.items()}
    if lone_unit is None and reach.tension_N is not None:
        asked = [round(share * reach.tension_N, 3) for share in (1.25, 0.8, 1.15, 1.0)]
        between = [step for to in asked for step in ({"set": {"path": _TENSION, "to": to}}, hold(2.2))]
        found["steps of tension"] = through(path, reach, [(0.6, RAMP_S, 1.5)], between)
    return {name: steps for name, steps in found.items() if START_S + duration_s(steps) <= LONGEST_S}


def proposed(found: Diagnosis, recording: Recording, place: str | Path) -> NextExperiment | None:
    """Experiment that would show more than the recording; None of a web that moved by other commands."""
    axes = found.model.axis_count
    if machines.is_lone(found.model):
        return propose(found, Reach.of_axis(measured_from(recording, found.model, place)))
    # Of a line with stations no move of the library is known to be one.
    if machines.has_stations(found.model) or f"v{axes}_cmd_m_s" not in recording:
        return None
    return propose(found, Reach.of_line(recording, axes))


def propose(found: Diagnosis, reach: Reach) -> NextExperiment | None:
    """The move, or two, that would show most of what `found` leaves open; None where no move would show it.

    Each is predicted with the model that was found, with and without the effect in question; how far the predictions
    lie apart, in units of the noise and with the other explanation fitted, is what it would show.
    """
    model, kind = found.model, machines.of_kind(found.model)
    lone = machines.is_lone(model)
    if not lone and getattr(model, "web", None) is None:
        return None
    sampled_s = _PERIOD_S if lone else None
    questions = list(questions_of(found, lambda axis: kind.sizes(model, axis, reach.top, reach.torque_Nm, sampled_s)))

    def answers(steps: list[Step]) -> Array:
        predicted = _axis_torque(steps, found, reach) if lone else line_signals(profile(steps), found, reach.tension_N)
        return np.array([question.answered_by(predicted(question.models)) for question in questions])

    return _best(moves(reach, model.position_unit if lone else None), questions, answers)


def _axis_torque(steps: list[Step], found: Diagnosis, reach: Reach) -> Callable[[list[Machine]], Array]:
    """Prediction by models (B,) of the torque of an axis that follows the steps (B, n), in units of the noise."""
    exact, kind = found.emulation is not None, machines.of_kind(found.model)
    noise_Nm = found.gap.noise_floor if exact else max(found.gap.noise_floor, found.gap.after)
    t, times, speeds, _ = profile(steps)
    v = gaussian_filter1d(np.interp(t, times, speeds), _FOLLOWS_S / _PERIOD_S)
    x, a = np.cumsum(v) * _PERIOD_S, np.gradient(v, _PERIOD_S)
    rows = np.flatnonzero(np.abs(v) > _STANDSTILL * reach.top)[:: 1 if exact else round(_APART_S / _PERIOD_S)]

    def predicted(models: list[Machine]) -> Array:
        torques = np.empty((len(models), len(v)))
        for one, out in zip(models, torques, strict=True):
            kind.required_torque_Nm(kind.pack(one), x, v, a, _PERIOD_S, out)
        return np.asarray(torques[:, rows] / max(noise_Nm, 1e-300))

    return predicted


def profile(steps: Sequence[Step]) -> Profile:
    """Profile of steps."""
    times, speeds, tensions = [0.0], [0.0], list[float | None]([None])
    for step in steps:
        ((kind, what),) = step.items()
        if kind == "set":
            tensions[-1] = what["to"]
            continue
        times.append(times[-1] + what["duration_s"])
        speeds.append(what["to"] if kind == "ramp" else speeds[-1])
        tensions.append(tensions[-1])
    return np.asarray(np.arange(round(times[-1] / _PERIOD_S)) * _PERIOD_S, np.float64), times, speeds, tensions


def duration_s(steps: Sequence[Step]) -> float:
    """Duration of steps, s."""
    return float(sum(one.get("duration_s", 0.0) for step in steps for one in step.values()))


def _best(
    library: Mapping[str, list[Step]], questions: Sequence[Question], answers: Callable[[list[Step]], Array]
) -> NextExperiment | None:
    """The move, or two, that would answer most of the questions; None where no move answers any.

    library: moves from standstill to standstill, none too long by itself, by name. answers: which questions
    (questions,) steps answer, as `Question.answered_by`.
    """
    if not questions:
        return None
    options: list[tuple[str, ...]] = [(name,) for name in library]
    options += [pair for pair in combinations(library, 2) if _takes(library, pair) <= LONGEST_S]
    of_move = {name: answers([hold(START_S), *steps]) for name, steps in library.items()}
    chosen, score = None, 0.0
    for names in options:
        # The information of moves adds up; longer ones have to bring more.
        gains = np.sum([of_move[name] for name in names], axis=0)
        value = sum(q.weight * np.log1p(min(g / q.least, _ENOUGH)) for q, g in zip(questions, gains, strict=True))
        value *= 1.0 - 0.01 * _takes(library, names)
        if value > score and any(g > q.least for q, g in zip(questions, gains, strict=True)):
            chosen, score = names, float(value)
    if chosen is None:
        return None
    gains = np.sum([of_move[name] for name in chosen], axis=0)
    reasons = [
        f"{q.text}: chi-square {g:.3g}, {'identified' if g > q.least else 'not identified'} (limit {q.least:g})"
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
