"""FMU simulation with its own communication steps, whatever steps are requested."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import floor
from weakref import finalize

from hilbench.plant.fmu.config import FmuBlock
from hilbench.plant.fmu.description import Variable
from hilbench.plant.fmu.process import FmuProcess

#: Rounding tolerance, as a share of a communication step.
_ROUNDING = 1e-6


class FmuState:
    """State saved in the FMU's process, for the lifetime of this object."""

    def __init__(self, process: FmuProcess, number: int, due_s: float, elapsed_s: float, pushed: list[float]) -> None:
        self.number, self.due_s, self.elapsed_s, self.pushed = number, due_s, elapsed_s, pushed
        finalize(self, _drop, process, number)


def _drop(process: FmuProcess, number: int) -> None:
    if process.close.alive:
        process.ask("drop_state", number)


class FmuModel:
    """Simulation of an FMU with inputs and outputs in SI; time begins at 0.

    `natural_s`: the usual requested step; `mean`: an input over a communication step is the mean of the values in it
    (torques), else the last one (positions). With communication steps of one length the FMU is at the last of their
    ends; the rest is carried over. `report`: callback for the FMU's log messages.
    """

    def __init__(
        self,
        block: FmuBlock,
        inputs: Sequence[Variable],
        outputs: Sequence[Variable],
        natural_s: float,
        report: Callable[[str], None],
        *,
        mean: bool = False,
    ) -> None:
        description = block.description()
        self.can_roll_back = description.can_roll_back
        self._inputs, self._outputs = tuple(inputs), tuple(outputs)
        self._in, self._out = [each.reference for each in inputs], [each.reference for each in outputs]
        self._step_s, self._mean = block.communication_step_s(natural_s), mean
        self._process = FmuProcess(description, block.timeout_s, report)
        self._given: dict[Variable, float] = {}  # set at each start
        self._known: dict[Variable, float] = {}
        self._pending: dict[Variable, float] = {}  # set with the next step
        self._due_s = self._elapsed_s = 0.0  # since the last step; the FMU's own time
        self._pushed = [0.0] * len(self._in)
        self.values: list[float] = []

    @property
    def behind_s(self) -> float:
        """Requested time that does not yet fill a communication step."""
        return self._due_s

    def start(self, time_s: float = 0.0) -> None:
        """Start (again), with the parameters set so far. Raises BenchFaultError."""
        references = [variable.reference for variable in self._given]
        self._process.ask("start", time_s, references, [each.own(value) for each, value in self._given.items()])
        self._known = dict(self._given)
        self._pending.clear()
        self._due_s, self._elapsed_s = 0.0, time_s
        self._pushed = [0.0] * len(self._in)
        self._look()

    def _look(self) -> None:
        self.values = self._si(self._process.ask("get", self._out))

    def _si(self, values: Sequence[float]) -> list[float]:
        return [variable.si(value) for variable, value in zip(self._outputs, values, strict=True)]

    def _own(self, values: Sequence[float]) -> list[float]:
        return [variable.own(value) for variable, value in zip(self._inputs, values, strict=True)]

    def advance(self, inputs: Sequence[float], duration_s: float) -> list[float]:
        """Advance with inputs held; returns the outputs then. Raises BenchFaultError for an FMU that fails."""
        if self._step_s is None:
            self._steps(inputs, duration_s, 1)
            return self.values
        self._due_s += duration_s
        if self._mean:
            self._pushed = [sum_ + value * duration_s for sum_, value in zip(self._pushed, inputs, strict=True)]
        count = floor(self._due_s / self._step_s + _ROUNDING)
        if count:
            if self._mean:
                inputs = [sum_ / self._due_s for sum_ in self._pushed]
                left_s = self._due_s - count * self._step_s
                self._pushed = [value * left_s for value in inputs]
            self._steps(inputs, self._step_s, count)
            self._due_s -= count * self._step_s
        return self.values

    def _steps(self, inputs: Sequence[float], step_s: float, count: int) -> None:
        references, own = list(self._in), self._own(inputs)
        for variable, value in self._pending.items():
            references.append(variable.reference)
            own.append(variable.own(value))
        self._pending.clear()
        self.values = self._si(self._process.ask("steps", references, own, self._elapsed_s, step_s, count, self._out))
        self._elapsed_s += count * step_s

    def ahead(self, inputs: Sequence[float], duration_s: float) -> list[float]:
        """Outputs predicted `duration_s` ahead with these inputs; the FMU's state is unchanged.

        Without rollback the present ones. Between two communication steps they are interpolated linearly.
        """
        if not self.can_roll_back or not duration_s > 0.0:
            return self.values
        own = self._own(inputs)
        if self._step_s is None:
            (values,) = self._process.ask("attempt", self._in, own, self._elapsed_s, duration_s, 1, self._out)
            return self._si(values)
        place = (self._due_s + duration_s) / self._step_s
        count = max(1, floor(place - _ROUNDING) + 1)
        found = self._process.ask("attempt", self._in, own, self._elapsed_s, self._step_s, count, self._out)
        after, share = self._si(found[-1]), place - (count - 1)
        before = self._si(found[-2]) if count > 1 else self.values
        return [low + share * (high - low) for low, high in zip(before, after, strict=True)]

    def put(self, variable: Variable, value: float) -> None:
        """Set a parameter from now on, SI. Raises ValueError for one that is fixed while the FMU runs."""
        if not variable.settable:
            raise ValueError(f"{variable.name} is fixed while the FMU runs, expected a tunable parameter")
        self._given[variable] = self._known[variable] = value
        self._process.ask("put", [variable.reference], [variable.own(value)])
        self._look()

    def put_with_next_step(self, variable: Variable, value: float) -> None:
        """Set a tunable parameter with the next step, without an exchange of its own."""
        self._given[variable] = self._known[variable] = self._pending[variable] = value

    def give(self, variable: Variable, value: float) -> None:
        """Set a variable at the next start, SI."""
        self._given[variable] = value

    def present(self, variable: Variable) -> float:
        """Present SI value of a parameter, cached as only this object changes it."""
        if variable not in self._known:
            (value,) = self._process.ask("get", [variable.reference])
            self._known[variable] = variable.si(value)
        return self._known[variable]

    def take_state(self) -> FmuState:
        """Present state. Raises ValueError for an FMU that can't save it."""
        if not self.can_roll_back:
            raise ValueError("the FMU can't hand its state out, expected one with canGetAndSetFMUstate")
        number = self._process.ask("take_state")
        return FmuState(self._process, number, self._due_s, self._elapsed_s, list(self._pushed))

    def give_state(self, state: FmuState) -> None:
        """Restore a state of this FMU."""
        self._process.ask("give_state", state.number)
        self._due_s, self._elapsed_s, self._pushed = state.due_s, state.elapsed_s, list(state.pushed)
        self._look()

    def close(self) -> None:
        """End the FMU's process."""
        self._process.close()
