"""The next experiment: of a small library of moves the one that, simulated, tells most of what is tied or not shown."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from numpy.typing import NDArray

from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.files import writing
from hilbench.plant.effects import EFFECTS, Effect, find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.imitation import Imitation
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.results.recording import Recording

Array = NDArray[np.float64]
Step = dict[str, dict[str, Any]]

#: Longest experiment that is proposed, s.
LONGEST_S: Final = 30.0
_SPEED, _TENSION = "line_speed_m_s", "tension_control.set_point_N"
#: Fall of the sum of squares from which two explanations are told apart, and of an effect from which it is visible.
_APART, _VISIBLE = 50.0, 25.0
#: How often over that a move need not be better, and weight of what is tied over what was not shown.
_ENOUGH, _TIE = 100.0, 20.0
#: How long a usual ramp takes, and over what time a steep one is looked for in what the machine has done, s.
_RAMP_S, _STEEP_S = 1.5, 0.2
#: Speeds between which steep ramps go, as shares of the top speed.
_LOW, _HIGH = 0.4, 0.7
_PERIOD_S: Final = 0.002


@dataclass(frozen=True)
class Reach:
    """What the machine has done already, and may be asked again."""

    top_m_s: float
    steepest_m_s2: float
    tension_N: float | None  #: usual set point; None where none may be set

    @classmethod
    def of(cls, recording: Recording, *, tension: bool = True) -> Reach:
        """By the commands of a recording of a web machine."""
        speed, t = np.asarray(recording["v2_cmd_m_s"], np.float64), recording.time_s
        apart = max(1, round(_STEEP_S / float(np.median(np.diff(t)))))
        steepest = float(np.max(np.abs(speed[apart:] - speed[:-apart]))) / _STEEP_S
        wanted = recording["F_ref_N"] if tension and "F_ref_N" in recording else None
        usual = None if wanted is None else float(np.median(np.asarray(wanted, np.float64)))
        return cls(float(np.max(np.abs(speed))), steepest, usual if usual and usual > 0.0 else None)


@dataclass(frozen=True)
class NextExperiment:
    """Steps from standstill to standstill, and why these."""

    steps: list[Step]
    moves: str  #: what they are, for a person
    reasons: list[str]  #: one line for each thing that they would tell
    duration_s: float


@dataclass(frozen=True)
class _Question:
    """Something that is not known: an effect that may be another, or one that could not be seen."""

    text: str
    with_it: ModelParameters
    without: ModelParameters
    instead: list[ModelParameters]  #: `without`, and some of the other effect
    least: float
    weight: float


def _hold(duration_s: float) -> Step:
    return {"hold": {"duration_s": round(duration_s, 3)}}


def _ramp(to: float, duration_s: float) -> Step:
    return {"ramp": {"path": _SPEED, "to": round(to, 4), "duration_s": round(duration_s + 5e-4, 3)}}


def _tension(to: float) -> Step:
    return {"set": {"path": _TENSION, "to": round(to, 3)}}


def moves(reach: Reach) -> dict[str, list[Step]]:
    """The library: each move from standstill to standstill, by what it is; those that take too long are left out."""
    # Backward a span's strain runs away with L/v, held by the tension loop alone: slowly, and not for long.
    levels: dict[str, list[tuple[float, float, float]]] = {
        "slowly forward and back": [(share, 0.5, 1.5) for share in (0.08, -0.08) * 2],
        "levels of speed": [(share, _RAMP_S, 2.0) for share in (0.25, 0.5, 0.75, 1.0)],
        "creep": [(0.02, 0.6, 4.0), (0.1, 0.6, 3.0), (0.3, 0.6, 2.0)],
        "steep ramps": [(_LOW, _RAMP_S, 1.0), *((share, 0.0, 1.0) for share in (_HIGH, _LOW) * 3)],
    }
    found = {name: _through(reach, each) for name, each in levels.items()}
    if reach.tension_N is not None:
        asked = [_tension(share * reach.tension_N) for share in (1.25, 0.8, 1.15, 1.0)]
        between = [step for one in asked for step in (one, _hold(2.2))]
        found["steps of tension"] = _through(reach, [(0.6, _RAMP_S, 1.5)], between)
    return {name: steps for name, steps in found.items() if 0.5 + duration_s(steps) <= LONGEST_S}


def _through(reach: Reach, levels: Sequence[tuple[float, float, float]], last: Sequence[Step] = ()) -> list[Step]:
    """Steps through levels of speed to standstill: share of the top speed, least time to it, time at it, s.

    last: what is done before the way to standstill.
    """
    steps: list[Step] = []
    speed = 0.0
    for share, least_s, stay_s in [*levels, (0.0, _RAMP_S, 0.5)]:
        to = share * reach.top_m_s
        if share == 0.0:
            steps += last
        steps += [_ramp(to, max(least_s, _STEEP_S, abs(to - speed) / reach.steepest_m_s2)), _hold(stay_s)]
        speed = to
    return steps


def duration_s(steps: Sequence[Step]) -> float:
    """How long steps take."""
    return float(sum(one.get("duration_s", 0.0) for step in steps for one in step.values()))


def propose(found: Diagnosis, reach: Reach) -> NextExperiment | None:
    """The move, or two, that would tell most of what `found` leaves open; None where no move would tell of it.

    Each is simulated with the model that was found, with and without what is asked; how far the predictions lie apart,
    in units of the noise and with the other explanation fitted, is what it would tell.
    """
    model = found.model
    if not isinstance(model, ModelParameters) or model.web is None:
        return None
    questions = list(_questions(found, model, reach))
    if not questions:
        return None
    library = moves(reach)
    options: list[tuple[str, ...]] = [(name,) for name in library]
    options += [pair for pair in combinations(library, 2) if _takes(library, pair) <= LONGEST_S]
    noise = {gap.signal: gap.noise_floor for gap in found.gaps}
    told = {name: _told(steps, found, model, reach, questions, noise) for name, steps in library.items()}
    best, score = None, 0.0
    for names in options:
        # What moves tell adds up; longer ones have to tell more.
        gains = np.sum([told[name] for name in names], axis=0)
        value = sum(q.weight * np.log1p(min(g / q.least, _ENOUGH)) for q, g in zip(questions, gains, strict=True))
        value *= 1.0 - 0.01 * _takes(library, names)
        if value > score and any(g > q.least for q, g in zip(questions, gains, strict=True)):
            best, score = names, float(value)
    if best is None:
        return None
    gains = np.sum([told[name] for name in best], axis=0)
    reasons = [
        f"{q.text}: chi-square {g:.3g}, {'told' if g > q.least else 'not told'} from {q.least:g} on"
        for q, g in zip(questions, gains, strict=True)
        if g > q.least or q.weight > 1.0
    ]
    steps = [_hold(0.5), *(step for name in best for step in library[name])]
    return NextExperiment(steps, ", then ".join(best), reasons, duration_s(steps))


def _takes(library: dict[str, list[Step]], names: tuple[str, ...]) -> float:
    return 0.5 + sum(duration_s(library[name]) for name in names)


def _questions(found: Diagnosis, model: ModelParameters, reach: Reach) -> Iterator[_Question]:
    for effect in found.effects:
        entry = next((e for e in model.effects if (e.effect, e.axis) == (effect.effect, effect.axis)), None)
        if entry is None:
            continue
        without = _less(model, entry)
        for name in effect.tied_with:
            other = _other(name, effect)
            if other is None:
                continue
            instead = [without.with_effects(one) for one in _tries(other, model, reach, entry)]
            text = f"whether it is {effect.effect} or {name}"
            yield _Question(text, model, without, instead, _APART, _TIE)
    for blind in found.unobservable:
        entries = _tries((find_effect(blind.effect), blind.axis), model, reach, None)
        for one in entries[:1]:
            with_it = model.with_effects(one)
            place = f" of axis {blind.axis}" if blind.axis else ""
            yield _Question(f"whether there is {blind.effect}{place}", with_it, model, [], _VISIBLE, 1.0)


def _less(model: ModelParameters, entry: EffectEntry) -> ModelParameters:
    rest = list(model.effects)
    rest.remove(entry)
    return model.model_copy(update={"effects": tuple(rest)})


def _other(name: str, effect: NamedEffect) -> tuple[Effect, int | None] | None:
    """Effect and axis of what something is tied with, by what is said of it; None for what is not in the vocabulary."""
    match = re.fullmatch(r"(\w+)(?: \(axis (\d+)\))?", name)
    if match is None or match[1] not in {one.id for one in EFFECTS}:
        return None
    known = find_effect(match[1])
    axis = int(match[2]) if match[2] else (effect.axis or 1)
    return known, axis if known.per_axis else None


def _tries(
    place: tuple[Effect, int | None], model: ModelParameters, reach: Reach, like: EffectEntry | None
) -> list[EffectEntry]:
    """Some of an effect at its usual size; of a wave at two phases; shaped as `like` where that has the same shape."""
    effect, axis = place
    sizes = machine_sizes(model, axis, top_speed_m_s=reach.top_m_s, torque_Nm=1.0)
    values = effect.filled({} if like is None else {k: v for k, v in like.parameters.items() if k.endswith(_SHAPES)})
    if sum((e.effect, e.axis) == (effect.id, axis) for e in model.effects) >= effect.slots:
        return []
    strength = effect.parameter(effect.strength[0])
    values[strength.name] = strength.size.on(sizes)
    phases = (0.0, 0.5 * np.pi) if "phase_rad" in values else (None,)
    return [
        EffectEntry(effect=effect.id, axis=axis, parameters=values | ({} if p is None else {"phase_rad": p}))
        for p in phases
    ]


_SHAPES = ("order", "frequency_Hz", "time_s", "duration_s")


def _told(
    steps: list[Step],
    found: Diagnosis,
    model: ModelParameters,
    reach: Reach,
    questions: list[_Question],
    noise: dict[str, float],
) -> Array:
    """What a move tells of each question: how far apart its answers lie, squared, in units of the noise."""
    data = _as_measured([_hold(0.5), *steps], model, reach)
    predictor = FreeRun(model, data, found.imitation if isinstance(found.imitation, Imitation) else None)
    sigma = np.array([noise.get(name, 0.0) for name in predictor.names])
    sigma = np.where(sigma > 0.0, sigma, predictor.tolerances)
    kept = np.flatnonzero(sigma > 0.0)

    def predicted(models: list[ModelParameters]) -> Array:
        rows = predictor.predict(np.array([lay.pack(model) for model in models]))
        return np.asarray((rows[:, kept] / sigma[kept, None])[:, :, predictor.rows].reshape(len(models), -1))

    told = []
    for question in questions:
        with_it, without, *instead = predicted([question.with_it, question.without, *question.instead])
        response = with_it - without
        if instead:
            other = np.array(instead) - without
            theta, *_ = np.linalg.lstsq(other.T, response, rcond=1e-10)
            response = response - theta @ other
        told.append(float(response @ response) if np.all(np.isfinite(response)) else 0.0)
    return np.array(told)


def _as_measured(steps: list[Step], model: ModelParameters, reach: Reach) -> Measured:
    """What a bench would command for the steps: speeds, and the strain that the tension asks for."""
    times, speeds, tensions = [0.0], [0.0], [reach.tension_N or model.boundary.upstream_tension_N]
    for step in steps:
        ((kind, what),) = step.items()
        if kind == "set":
            tensions[-1] = what["to"]
            continue
        times.append(times[-1] + what["duration_s"])
        speeds.append(what["to"] if kind == "ramp" else speeds[-1])
        tensions.append(tensions[-1])
    t = np.asarray(np.arange(round(times[-1] / _PERIOD_S)) * _PERIOD_S, np.float64)
    v2 = np.interp(t, times, speeds)
    tension = np.array(tensions)[np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(tensions) - 1)]
    stiffness = model.stiffness_N(1)
    v1 = v2 * (1.0 - (tension / stiffness - model.upstream_strain))
    n, axes = len(t), range(1, model.axis_count + 1)
    zero = np.zeros(n)
    return Measured(
        t_s=t,
        period_s=_PERIOD_S,
        commands_m_s=np.column_stack([v1, v2]),
        boundary=np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (n, 1)),
        tau_Nm=dict.fromkeys(axes, zero),
        x_m=dict.fromkeys(axes, zero),
        v_m_s={},
    )


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
    text = yaml.safe_dump({**head, "steps": proposed.steps, "criteria": []}, sort_keys=False, default_flow_style=None)
    with writing(path):
        path.write_text("\n".join([*lines, text]), encoding="utf-8")
    return path
