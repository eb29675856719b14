"""What the steps of an experiment will ask of a bench, as far as that can be known before it runs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

from hilbench.bench import quantities
from hilbench.errors import UnusableInputError
from hilbench.experiment.config import ExperimentConfig, LoadedConfig
from hilbench.experiment.scenario import read_scenario
from hilbench.strict_yaml import Location
from hilbench.web.effects import IMITATED_DOMAINS, STAND_DOMAINS, Domain, find_effect

_LENGTH_ERROR = "load.effects.span_length_error.relative_change"
_SHIFT = "load.effects.elasticity_shift.relative_change"
_STEP_TIME = "load.effects.elasticity_step.time_s"
_STEP = "load.effects.elasticity_step.relative_change"
_DRIFT = "load.effects.elasticity_drift.rate_per_s"


@dataclass(frozen=True)
class State:
    """What has been asked for, from `time_s` of the experiment on. `values`: by path (`bench.quantities`)."""

    time_s: float
    place: Location  #: of the step in the config
    values: dict[str, float] = field(default_factory=dict)

    @property
    def line_speed_m_s(self) -> float:
        """Set-point of axis 2."""
        return self.values[quantities.LINE_SPEED]

    @property
    def set_point_N(self) -> float:
        """Of the tension."""
        return self.values[quantities.TENSION_SET_POINT]

    @property
    def youngs_modulus_Pa(self) -> float:
        """E of the imitated web, with its effects."""
        values = self.values
        stepped = 1.0 + values[_STEP] if self.time_s >= values[_STEP_TIME] else 1.0
        drifted = 1.0 + values[_DRIFT] * self.time_s
        return values[quantities.YOUNGS_MODULUS] * (1.0 + values[_SHIFT]) * stepped * drifted

    @property
    def length_factor(self) -> float:
        """Of the imitated span."""
        return 1.0 + self.values[_LENGTH_ERROR]


@dataclass(frozen=True)
class Move:
    """From one state to the next, within `duration_s` (0: at once)."""

    before: State
    after: State
    duration_s: float


def start_of(config: ExperimentConfig) -> State:
    """The state in which the drives are enabled."""
    modulus_Pa = config.load.web.youngs_modulus_Pa or config.model.required_web.youngs_modulus_Pa
    values = {
        quantities.LINE_SPEED: 0.0,
        quantities.TENSION_SET_POINT: config.tension_control.set_point_N,
        quantities.YOUNGS_MODULUS: modulus_Pa,
        **dict.fromkeys((_LENGTH_ERROR, _SHIFT, _STEP, _STEP_TIME, _DRIFT), 0.0),
    }
    for entry in config.load.effects:
        values |= {f"load.effects.{entry.effect}.{name}": value for name, value in entry.parameters.items()}
    return State(0.0, ("steps",), values)


def moves(loaded: LoadedConfig) -> Iterator[Move]:
    """Every change that the YAML steps and tables ask for, in order; what Python files ask for is not in it.

    Raises UnusableInputError with the place of a step that changes an effect which is not where it says.
    """
    state = start_of(loaded.config)
    for number, step in enumerate(loaded.config.steps):
        place: Location = ("steps", number, step.kind)
        if step.ramp is not None:
            ramp = step.ramp
            way = abs(ramp.to - state.values.get(ramp.path, 0.0))
            lasts_s = ramp.duration_s or way / (ramp.rate_per_s or 1.0)
            move = _move(loaded, state, place, ramp.path, ramp.to, lasts_s)
            yield move
            state = move.after
        elif step.set is not None or step.step is not None:
            given = step.set or step.step
            assert given is not None, "one of the two"
            move = _move(loaded, state, place, given.path, given.to, 0.0)
            yield move
            state = move.after
        elif step.table is not None:
            for move in _of_table(loaded, state, place):
                yield move
                state = move.after
        else:
            passes_s = 0.0
            if step.hold is not None:
                until_s = step.hold.until_s or 0.0
                given_s = step.hold.duration_s
                passes_s = given_s if given_s is not None else max(0.0, until_s - state.time_s)
            elif step.wait_until is not None:
                passes_s = step.wait_until.timeout_s
            after = replace(state, time_s=state.time_s + passes_s, place=place)
            yield Move(state, after, passes_s)
            state = after


def _move(loaded: LoadedConfig, state: State, place: Location, path: str, value: float, lasts_s: float) -> Move:
    problem = _misplaced(path)
    if problem:
        raise UnusableInputError(loaded.document.place((*place, "path")), f"'{path}', expected {problem}")
    values = {**state.values, path: value}
    return Move(state, State(state.time_s + lasts_s, place, values), lasts_s)


def _of_table(loaded: LoadedConfig, state: State, place: Location) -> Iterator[Move]:
    step = loaded.config.steps[int(place[1])].table
    assert step is not None, "a table"
    scenario = read_scenario(step.file)
    points = [(t_s, path, value, 0.0) for path, course in scenario.jumps.items() for t_s, value in course]
    for path, course in scenario.ramps.items():
        times = [t_s for t_s, _ in course]
        lasting = [0.0, *(later - earlier for earlier, later in pairwise(times))]
        points += [(t_s, path, value, lasts_s) for (t_s, value), lasts_s in zip(course, lasting, strict=True)]
    began_s = state.time_s
    for t_s, path, value, lasts_s in sorted(points, key=lambda point: point[0]):
        begun = replace(state, time_s=began_s + t_s - lasts_s)
        move = _move(loaded, begun, place, path, value, lasts_s)
        yield move
        state = move.after
    yield Move(state, replace(state, time_s=began_s + scenario.duration_s), 0.0)


def _misplaced(path: str) -> str | None:
    """Why an effect can't be where a path has it, as what is expected, or None."""
    if path in quantities.PLAIN_PATHS:
        return None
    known = quantities.parse_effect_path(path)
    domain = find_effect(known.effect).domain
    if known.place == "hardware":
        return None if domain in STAND_DOMAINS else "an effect of the axes; the web's are in 'load.effects'"
    if domain not in IMITATED_DOMAINS:
        return "an effect of the web or a roller's resistance; those of the axes are in 'hardware.effects'"
    if domain is Domain.ROLLER_RESISTANCE and known.axis != 2:
        return "axis 2, where the load motor is; other axes' are in 'hardware.effects'"
    return None
