"""Set-point schedule of an experiment's steps, as far as it is known before the run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

from hilbench.machine_kinds import machine_part
from hilbench.plant.effects import find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.prediction import plan as planned
from hilbench.runs import web_line_values
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.scenario import read_scenario
from hilbench.runs.steps import TableStep
from hilbench.strict_yaml import Location
from hilbench.topology import quantities
from hilbench.topology.web_line_quantities import span_of_set_point

_LOAD_EFFECT = "load.effects."


@dataclass(frozen=True)
class State:
    """Set points from `time_s` of the experiment on. `values`: by path (`topology.quantities`);
    `effects`: those of the emulated web in the config, beside the ones that a path changes."""

    time_s: float
    place: Location  #: of the step in the config
    values: Mapping[str, float]
    effects: tuple[EffectEntry, ...] = ()

    @property
    def line_speed_m_s(self) -> float:
        """Set-point of the last axis."""
        return self.values[quantities.LINE_SPEED]

    @property
    def set_points_N(self) -> dict[str, float]:
        """Tension set-points, by path."""
        return {path: value for path, value in self.values.items() if span_of_set_point(path) is not None}

    @property
    def load_effects(self) -> dict[tuple[str, int | None, int | None], dict[str, float]]:
        """Values given for effects in the emulated mechanics that a path changes, by effect, axis and section."""
        changed: dict[tuple[str, int | None, int | None], dict[str, float]] = {}
        for path, value in self.values.items():
            if path.startswith(_LOAD_EFFECT):
                known = quantities.parse_effect_path(path)
                changed.setdefault((known.effect, known.axis, known.section), {})[known.parameter] = value
        return changed


@dataclass(frozen=True)
class Move:
    """Change from one state to the next, within `duration_s` (0: at once)."""

    before: State
    after: State
    duration_s: float


def start_of(config: ExperimentConfig) -> State:
    """The state in which the drives are enabled."""
    values: dict[str, float] = machine_part(config.machine.kind, "start_values")(config)
    others: list[EffectEntry] = []
    for number, entry in enumerate(config.load.effects):
        place = (entry.effect, entry.axis, entry.section)
        again = any((later.effect, later.axis, later.section) == place for later in config.load.effects[number + 1 :])
        if again or entry.station is not None:  # a path changes the last one of a kind, and none of a station
            others.append(entry)
            continue
        known = find_effect(entry.effect, config.machine.machine_kind)
        at = entry.axis if known.per_axis else entry.section
        part = "" if at is None else f"{known.part}{at}."
        values |= {f"{_LOAD_EFFECT}{entry.effect}.{part}{name}": value for name, value in entry.parameters.items()}
    return State(0.0, ("steps",), values, tuple(others))


def moves(config: ExperimentConfig) -> Iterator[Move]:
    """Every change that the YAML steps and tables ask for, in order; what Python files ask for is not in it."""
    state = start_of(config)
    for number, step in enumerate(config.steps):
        place: Location = ("steps", number, step.kind)
        if step.ramp is not None:
            ramp = step.ramp
            change = abs(ramp.to - state.values.get(ramp.path, 0.0))
            lasts_s = ramp.duration_s or change / (ramp.rate_per_s or 1.0)
            found = [_move(state, place, ramp.path, ramp.to, lasts_s)]
        elif given := step.set or step.step:
            found = [_move(state, place, given.path, given.to, 0.0)]
        elif step.table is not None:
            found = list(_of_table(step.table, state, place))
        else:
            passes_s = 0.0
            if step.hold is not None:
                until_s = step.hold.until_s or 0.0
                given_s = step.hold.duration_s
                passes_s = given_s if given_s is not None else max(0.0, until_s - state.time_s)
            elif step.wait_until is not None:
                passes_s = step.wait_until.timeout_s
            found = [Move(state, replace(state, time_s=state.time_s + passes_s, place=place), passes_s)]
        yield from found
        state = found[-1].after


def _move(state: State, place: Location, path: str, value: float, lasts_s: float) -> Move:
    values = web_line_values.changed({**state.values, path: value}, path)
    after = replace(state, time_s=state.time_s + lasts_s, place=place, values=values)
    return Move(state, after, lasts_s)


def _of_table(table: TableStep, state: State, place: Location) -> Iterator[Move]:
    scenario = read_scenario(table.file)
    points = [(t_s, path, value, 0.0) for path, course in scenario.jumps.items() for t_s, value in course]
    for path, course in scenario.ramps.items():
        times = [t_s for t_s, _ in course]
        lasting = [0.0, *(later - earlier for earlier, later in pairwise(times))]
        points += [(t_s, path, value, lasts_s) for (t_s, value), lasts_s in zip(course, lasting, strict=True)]
    began_s = state.time_s
    for t_s, path, value, lasts_s in sorted(points, key=lambda point: point[0]):
        begun = replace(state, time_s=began_s + t_s - lasts_s)
        move = _move(begun, place, path, value, lasts_s)
        yield move
        state = move.after
    yield Move(state, replace(state, time_s=began_s + scenario.duration_s), 0.0)


#: Steps that take as long as they take, or do what only their own code knows.
_OPEN = {"wait_until", "python", "restart_twin"}


class LookAhead:
    """The steps of one experiment with the times that they will take."""

    def __init__(self, config: ExperimentConfig) -> None:
        self._kinds = [step.kind for step in config.steps]
        self._starts_s = [0.0] * len(self._kinds)
        self._moves: list[tuple[int, planned.Move]] = []
        state, number = start_of(config), -1
        for move in moves(config):
            at = move.after.place[1]
            assert isinstance(at, int), "the number of a step"
            if at != number:
                number = at
                self._starts_s[number] = state.time_s
            state = move.after
            begins_s = move.before.time_s
            for path, to in move.after.values.items():
                if move.before.values.get(path) != to:
                    self._moves.append((number, planned.Move(path, begins_s, begins_s + move.duration_s, to)))

    def plan(self, number: int, now_s: float) -> planned.Plan:
        """Plan from the step of this number (from 0), which begins now, to the first one of unknown duration."""
        until = next((k for k in range(number, len(self._kinds)) if self._kinds[k] in _OPEN), len(self._kinds))
        later_s = now_s - self._starts_s[number]
        return planned.Plan(
            tuple(
                replace(move, start_s=move.start_s + later_s, end_s=move.end_s + later_s)
                for step, move in self._moves
                if number <= step < until
            )
        )
