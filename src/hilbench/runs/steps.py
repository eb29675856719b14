"""The steps of an experiment as written in YAML, and how each is run on a bench; a Python file's experiment is a
generator function, resumed every cycle with that cycle's sample."""

from __future__ import annotations

import importlib.util
import operator
import re
import traceback
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FilePath,
    PositiveFloat,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)

from hilbench.bench.bench import Bench
from hilbench.block import Block
from hilbench.did_you_mean import did_you_mean
from hilbench.errors import BenchFaultError, HilbenchError, UnusableInputError, UnusableValueError
from hilbench.estimation.web_line.config import METHODS
from hilbench.runs.criteria import CriterionResult, failed_or_passed
from hilbench.runs.scenario import read_scenario
from hilbench.topology.quantities import LONGEST_S, permitted, rampable_path, settable_path
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import example_names, find_signal

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_CONDITION = re.compile(r"^\s*(\w+)\s*(<=|>=|<|>)\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*$")


def _permitted_value(value: object, info: ValidationInfo) -> object:
    """Check the value against its path; an invalid path has an error of its own."""
    path = info.data.get("path")
    if path is not None and not permitted(path).holds(value):
        raise ValueError(f"{permitted(path)} for {path}")
    return value


SettablePath = Annotated[str, AfterValidator(settable_path)]
RampedPath = Annotated[str, AfterValidator(rampable_path)]
Value = Annotated[float, BeforeValidator(_permitted_value)]
Duration = Annotated[float, Field(gt=0.0, le=LONGEST_S)]
NoOrSomeTime = Annotated[float, Field(ge=0.0, le=LONGEST_S)]


def parse_condition(text: str) -> tuple[str, str, float]:
    """Split ``signal < value`` into its parts. Raises ValueError when it is no comparison of a known signal."""
    match = _CONDITION.match(text)
    if match is None:
        raise ValueError("a comparison such as 'v1_m_s >= 2.9'")
    signal, comparison, value = match.groups()
    if find_signal(signal) is None:
        raise ValueError(f"a signal of the recording, '{signal}' is none{did_you_mean(signal, example_names())}")
    return signal, comparison, float(value)


def _condition(text: str) -> str:
    parse_condition(text)
    return text


def _method(name: str) -> str:
    if name not in METHODS:
        raise ValueError(f"one of {', '.join(METHODS)}{did_you_mean(name, METHODS)}")
    return name


Method = Annotated[str, AfterValidator(_method), WithJsonSchema({"type": "string", "enum": list(METHODS)})]


class CheckedMove(Block):
    """Step that may be checked before it is done: does the twin's prediction cross a trip level?"""

    check: Literal["predicted"] | None = Field(
        default=None,
        description="predicted: look ahead first, and refuse the step (a bench fault, as a limit that is crossed) "
        "where a trip level would be crossed within the horizon",
    )
    check_above: float = Field(default=0.1, ge=0, lt=1, description="probability above which the step is refused")

    def make_sure(self, bench: Bench, path: str, to: float, duration_s: float = 0.0) -> None:
        """Raise PredictedLimitError where it is refused."""
        if self.check is not None:
            bench.refuse_if_predicted(path, to, duration_s, self.check_above)


class Ramp(CheckedMove):
    """Move a quantity linearly: at `rate_per_s` (unit of the quantity per second) or within `duration_s`."""

    path: RampedPath = Field(description="what is moved")
    to: Value = Field(description="value at the end, SI")
    rate_per_s: PositiveFloat | None = Field(default=None, description="how fast, in the quantity's unit per second")
    duration_s: Duration | None = Field(default=None, description="how long it takes")

    @model_validator(mode="after")
    def _one_of_two(self) -> Ramp:
        if (self.rate_per_s is None) == (self.duration_s is None):
            raise ValueError("either rate_per_s or duration_s")
        return self

    def run(self, bench: Bench) -> None:
        """Run cycles until the quantity has arrived."""
        distance = abs(self.to - bench.get(self.path))
        duration_s = self.duration_s or distance / (self.rate_per_s or 1.0)
        if duration_s > LONGEST_S:
            raise BenchFaultError(
                f"ramp of {self.path} by {distance:g} at {self.rate_per_s:g} per s takes {duration_s:g} s, "
                f"expected at most {LONGEST_S:g} s"
            )
        self.make_sure(bench, self.path, self.to, duration_s)
        bench.ramp(self.path, self.to, max(duration_s, bench.config.cycle_time_s))


class Hold(Block):
    """Run the bench for `duration_s`, or until experiment time `until_s`."""

    duration_s: NoOrSomeTime | None = Field(default=None, description="how long")
    until_s: NoOrSomeTime | None = Field(default=None, description="experiment time at the end")

    @model_validator(mode="after")
    def _one_of_two(self) -> Hold:
        if (self.duration_s is None) == (self.until_s is None):
            raise ValueError("either duration_s or until_s")
        return self

    def run(self, bench: Bench) -> None:
        """Run cycles for the time; an `until_s` that has passed already runs none."""
        left_s = self.duration_s if self.duration_s is not None else (self.until_s or 0.0) - bench.time_s
        bench.run(max(0.0, left_s))


class Set(CheckedMove):
    """Give quantities a value from the next cycle on."""

    path: SettablePath = Field(description="what is set")
    to: Value = Field(description="its new value, SI")
    announced: bool = Field(
        default=False,
        description="the machine is changed on purpose (another roller): the twin's model gets this effect, too, and "
        "the diagnosis beside the run takes it for no anomaly",
    )

    @model_validator(mode="after")
    def _can_be_announced(self) -> Self:
        if self.announced and ".effects." not in self.path:
            raise ValueError(f"'announced' for a parameter of an effect, '{self.path}' is none")
        return self

    def run(self, bench: Bench) -> None:
        """Set it; takes no time."""
        self._give(bench, bench.set)

    def _give(self, bench: Bench, change: Callable[[str, float], None]) -> None:
        self.make_sure(bench, self.path, self.to)
        change(self.path, self.to)
        if self.announced and bench.model_changes is not None:
            bench.model_changes.announced(self.path, self.to)


class Step(Set):
    """A step change under test: as `set`, and marked as an event that metrics and report refer to."""

    def run(self, bench: Bench) -> None:
        """Set it and note the event."""
        self._give(bench, bench.step)


class WaitUntil(Block):
    """Run until a signal of the recording fulfils a condition; a bench fault when it does not in time."""

    condition: Annotated[str, AfterValidator(_condition)] = Field(
        description="a comparison of a signal: 'v1_m_s >= 2.9'"
    )
    timeout_s: Duration = Field(description="how long it may take; then the run ends as a bench fault")
    for_s: NoOrSomeTime = Field(default=0.0, description="the condition must hold so long without a break")

    def run(self, bench: Bench) -> None:
        """Run cycles until the condition has held for `for_s`."""
        signal, comparison, value = parse_condition(self.condition)
        holds = _COMPARISONS[comparison]
        fulfilled = bench.wait_until(
            lambda sample: holds(getattr(sample, signal), value), timeout_s=self.timeout_s, for_s=self.for_s
        )
        if not fulfilled:
            raise BenchFaultError(f"wait_until: '{self.condition}' did not come true within {self.timeout_s:g} s")


class RestartTwin(Block):
    """Reset the twin while the plant runs; the tension loop is open until it is synchronized again."""

    def run(self, bench: Bench) -> None:
        """Reset, configure and start the twin's nodes."""
        bench.restart_twin()


class UseSynchronizer(Block):
    """Switch the twin to another method from its present E, with that method's defaults."""

    method: Method = Field(description="as in twin: estimate: method")

    def run(self, bench: Bench) -> None:
        """Switch; takes no time."""
        bench.use_synchronizer(self.method)


class TableStep(Block):
    """Run a scenario table (`hilbench.runs.scenario`); its expectations are judged as criteria are."""

    file: FilePath = Field(description="CSV or YAML; a relative path is taken from the config file's folder")

    @model_validator(mode="after")
    def _can_be_read(self) -> TableStep:
        read_scenario(self.file)  # raises UnusableInputError with the table's own file and line
        return self

    def run(self, bench: Bench, judged: list[CriterionResult]) -> None:
        """Run cycles until the table ends."""
        read_scenario(self.file).run(bench, judged)


class PythonStep(Block):
    """Run a generator function of a Python file, resumed every cycle; it passes when no assertion in it fails."""

    file: FilePath = Field(description="Python file; a relative path is taken from the config file's folder")
    function: str = Field(default="experiment", description="generator function, called with the bench")

    def run(self, bench: Bench, judged: list[CriterionResult]) -> None:
        """Run cycles until it returns; an assertion that fails is a failed criterion, anything else it raises a bench
        fault.

        Raises BenchFaultError naming file and line.
        """
        path, experiment = self.file, load_experiment(self.file, self.function)
        name = f"{path.name}: {self.function}"
        try:
            bench.follow(experiment(bench))
        except UnusableValueError as error:
            raise BenchFaultError(f"{_place(path, error)}: {error}") from error
        except (HilbenchError, KeyboardInterrupt):
            raise
        except AssertionError as error:
            text = f"{_place(path, error)}: {error}".rstrip(": ")
            judged.append(failed_or_passed(name, text))
        except BaseException as error:  # a SystemExit ends the run as any other does
            raise BenchFaultError(f"{_place(path, error)}: {type(error).__name__}: {error}") from error
        else:
            judged.append(failed_or_passed(name))


Action = Ramp | Hold | Set | Step | WaitUntil | RestartTwin | UseSynchronizer
JudgedAction = TableStep | PythonStep


class ExperimentStep(Block):
    """One entry of `steps:`, a mapping with a single key that names the action."""

    ramp: Ramp | None = None
    hold: Hold | None = None
    set: Set | None = None
    step: Step | None = None
    wait_until: WaitUntil | None = None
    restart_twin: RestartTwin | None = None
    synchronizer: UseSynchronizer | None = None
    table: TableStep | None = None
    python: PythonStep | None = None

    @model_validator(mode="after")
    def _single(self) -> ExperimentStep:
        if len(self._given()) != 1:
            raise ValueError(f"one of {', '.join(type(self).model_fields)} in each step")
        return self

    def _given(self) -> list[tuple[str, Action | JudgedAction]]:
        return [(name, value) for name, value in self if value is not None]

    @property
    def kind(self) -> str:
        """Key of the step."""
        return self._given()[0][0]

    def prepare(self) -> None:
        """Raise UnusableInputError for a Python file that cannot be used; before anything is started."""
        if self.python is not None:
            load_experiment(self.python.file, self.python.function)

    def run(self, bench: Bench, judged: list[CriterionResult]) -> None:
        """Run it on a bench; verdicts of what it tests itself are added to `judged`."""
        action = self._given()[0][1]
        if isinstance(action, TableStep | PythonStep):
            action.run(bench, judged)
        else:
            action.run(bench)


Experiment = Callable[[Bench], Generator[None, CycleSample, None]]


def load_experiment(path: Path, function: str) -> Experiment:
    """The generator function of a file. Raises UnusableInputError when the file or the function is none."""
    spec = importlib.util.spec_from_file_location(f"hilbench_experiment_{path.stem}", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise UnusableInputError(path, "no such Python file, expected one with the experiment")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever the file raises, a SystemExit too: it is the author's to read
        raise UnusableInputError(_place(path, error), f"{type(error).__name__}: {error}") from error
    found = getattr(module, function, None)
    if not callable(found):
        raise UnusableInputError(path, f"no function '{function}', expected a generator function of the bench")
    experiment: Experiment = found
    return experiment


def _place(path: Path, error: BaseException) -> str:
    """The last line of the file that the error passed."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if Path(frame.filename) == path]
    return f"{path}:{lines[-1]}" if lines else str(path)
