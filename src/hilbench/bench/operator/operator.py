"""Requests to a running bench: values of its quantities by path, steps under test, requests over the bus."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.operator.operator_objects import OperatorObjects
from hilbench.bench.reports.change import Change
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import MANY, CompiledStages, CyclicTask, Outputs, SettableQuantity
from hilbench.errors import UnusableValueError
from hilbench.topology import quantities
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample


@dataclass(frozen=True)
class StepEvent:
    """A step change under test."""

    time_s: float
    path: str
    before: float
    after: float


class Cycles(Protocol):
    """Runs the cycles of a bench."""

    def cycle(self) -> object:
        """Run one."""

    def cycles_at_once(self, most: int) -> int:
        """Run up to `cycles` compiled. Returns the number run; 0 if the next one needs Python."""


class Operator(CyclicTask):
    """The settable quantities of one bench, for an experiment or an operator over the bus.

    `owners`: owners of the quantities; every path of `hilbench.topology.quantities` has one. As a task it applies
    requests received over the bus between two cycles; the reference moves at the rate at which the bench itself slows
    down.
    """

    def __init__(
        self, config: BenchConfig, state: BenchState, reference: Reference, owners: Sequence[SettableQuantity]
    ) -> None:
        self.events: list[StepEvent] = []
        self.objects = OperatorObjects(config, self.get, self._may_change)
        self._config = config
        self._known: set[str] = set()  # paths that were looked at, and are quantities of this bench
        self._state = state
        self._reference = reference
        self._owners = owners
        self._ramped = ""  # the quantity that a ramp of the experiment moves

    def get(self, path: str) -> float:
        """Present value. Raises UnusableValueError for an unknown path."""
        path = quantities.checked_path(path)
        if path not in self._known:
            problem = self._config.path_problem(path)
            if problem:
                raise UnusableValueError(f"path {path!r}, expected {problem}")
            self._known.add(path)
        self._state.running()
        return self._owner(path).value(path)

    def set(self, path: str, value: float) -> None:
        """Another value from the next cycle on. Raises UnusableValueError."""
        value, before = quantities.checked_value(quantities.checked_path(path), value), self.get(path)
        self._owner(path).set(path, value)
        self._state.journal(Change(self._state.running().timing.cycles, "set", path, value, before))

    def step(self, path: str, to: float) -> None:
        """`set`, noted as an event under test."""
        to = quantities.checked_value(quantities.checked_path(path), to)
        self.events.append(StepEvent(self._state.sample.t_s, path, self.get(path), to))
        self.set(path, to)

    def ramp(self, path: str, to: float, duration_s: float, cycles: Cycles) -> None:
        """Move a quantity linearly, cycle by cycle. Raises UnusableValueError before anything moves."""
        path = quantities.checked_path(path, quantities.rampable_path)
        to = quantities.checked_value(path, to)
        duration_s = quantities.checked_duration_s("duration_s", duration_s, above_zero=True)
        count = max(1, round(duration_s / self._state.cycle_s))
        start = self.get(path)
        self.follow(path, start + (to - start) * np.arange(1, count + 1) / count, cycles)

    def follow(self, path: str, values: NDArray[np.float64], cycles: Cycles) -> None:
        """Give a quantity these values, one in each cycle. Raises UnusableValueError before anything moves."""
        self._ramped = path
        try:
            while len(values):
                done = self._follow_compiled(path, values, cycles)
                if not done:
                    self.set(path, float(values[0]))
                    cycles.cycle()
                    done = 1
                values = values[done:]
        finally:
            self._ramped = ""

    def _follow_compiled(self, path: str, values: NDArray[np.float64], cycles: Cycles) -> int:
        """`follow` in compiled cycles. Returns how many values were consumed; 0 if the next cycle needs Python."""
        reference, before = self._reference, self._reference.present
        if not (reference.owns(path) and reference.goal is None and reference.ceiling is None):
            return 0
        first, count = self._state.running().timing.cycles, reference.load_trajectory(values)
        try:
            return cycles.cycles_at_once(count)
        finally:
            for at, value in enumerate(values[: reference.end_trajectory()].tolist()):
                self._state.journal(Change(first + at, "set", path, value, before))
                before = value

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        """Apply requests received over the bus since the last cycle."""
        for path, value in self.objects.changes():
            self._state.reports.note("operator", f"{path} from {self.get(path):.6g} to {value:.6g}")
            if self._reference.owns(path):
                self._reference.move_to(value)
            elif path == quantities.MODEL_CHANGE:
                self.set(path, value)
            else:
                self.step(path, value)
        goal = self._reference.goal
        if goal is not None:
            value, is_there = self._reference.step_to(goal)
            self.set(self._reference.path, value)
            if not is_there:
                self._reference.move_to(goal)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Compiled trajectory of the reference, while there is no other request."""
        return CompiledStages(
            before=[self._reference.piece],
            cycles=lambda: 0 if self.objects.asked or self._reference.goal is not None else MANY,
        )

    def slow_down(self) -> Iterator[None]:
        """Bring the reference to zero at the rate of a quick stop, a step for each item."""
        while self._reference.slow_down():
            yield

    def _owner(self, path: str) -> SettableQuantity:
        return next(owner for owner in self._owners if owner.owns(path))

    def _may_change(self, path: str) -> bool:
        """Only while the experiment runs, and nothing that it moves itself just now."""
        return self._state.enabled and not self._state.stopping and path != self._ramped
