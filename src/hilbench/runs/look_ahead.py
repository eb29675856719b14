"""Look-ahead plan of a bench: what the rest of an experiment will ask for, and when."""

from __future__ import annotations

from hilbench.prediction.plan import Move, Plan
from hilbench.runs.config import ExperimentConfig
from hilbench.runs.set_point_schedule import moves, start_of

#: Steps that take as long as they take, or do what only their own code knows.
_OPEN = {"wait_until", "python", "restart_twin"}


class LookAhead:
    """The steps of one experiment with the times that they will take."""

    def __init__(self, config: ExperimentConfig) -> None:
        self._kinds = [step.kind for step in config.steps]
        self._starts_s = [0.0] * len(self._kinds)
        self._moves: list[tuple[int, Move]] = []
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
                    self._moves.append((number, Move(path, begins_s, begins_s + move.duration_s, to)))

    def plan(self, number: int, now_s: float) -> Plan:
        """Plan from the step of this number (from 0), which begins now, to the first one of unknown duration."""
        until = next((k for k in range(number, len(self._kinds)) if self._kinds[k] in _OPEN), len(self._kinds))
        later_s = now_s - self._starts_s[number]
        return Plan(
            tuple(
                Move(move.path, move.start_s + later_s, move.end_s + later_s, move.to)
                for step, move in self._moves
                if number <= step < until
            )
        )
