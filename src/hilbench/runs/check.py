"""Checks of a config and its experiment before anything starts, and warnings for the operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite

from hilbench.bench.check import CheckedBench, check_bench
from hilbench.bench.prediction.create import foreseeable
from hilbench.bench.tasks.tension_loop import Margins, OperatingPoint
from hilbench.bench.web_line_check import operating_point_text
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError, UnusableValueError
from hilbench.exchange.effect_objects import effect_place
from hilbench.machine_kinds import machine_part
from hilbench.runs.config import LoadedConfig
from hilbench.runs.drive_check import drive_warnings
from hilbench.runs.estimated_errors import find_metric as find_found_metric
from hilbench.runs.metrics import OF_RUNS, metrics_of
from hilbench.runs.set_point_schedule import Move, moves


@dataclass(frozen=True)
class Worst:
    """The operating point with the least margins."""

    point: OperatingPoint
    margins: Margins

    def __str__(self) -> str:
        gain = f"{self.margins.gain:.2f}" if isfinite(self.margins.gain) else "any"
        at = operating_point_text(self.point)
        return f"gain margin {gain}, phase margin {self.margins.phase_deg:.0f}° where they are least: {at}"


@dataclass(frozen=True)
class CheckedExperiment:
    """Result of the check."""

    bench: CheckedBench
    #: Stiffest web that the load motor could emulate by itself, over the stiffest asked for; None: there is no web.
    stiffness_reserve: float | None
    worst: Worst | None  #: None where margins were not asked for
    warnings: list[str]  #: what will happen that hardly anybody means to happen
    notes: list[str]  #: what can be run, and will not be good; what can't be known
    inertia_reserve: float | None = None  #: largest inertia that can be emulated, over the largest asked for
    #: `stiffness_reserve` of each load motor, by its name.
    stiffness_reserves: Mapping[str, float] = field(default_factory=dict)


def check_experiment(loaded: LoadedConfig, *, with_margins: bool = False) -> CheckedExperiment:
    """Check a config and what its steps ask for, as far as can be without a bus.

    Raises UnusableInputError as `check_bench`, for a Python file that can't be used, and with the step's place where
    the loop through web, drives, bus and twin would be unstable.
    """
    config, document = loaded.config, loaded.document
    bench = check_bench(config, document)
    for step in config.steps:
        step.prepare()
    asked = list(moves(config))
    _check_paths(loaded, asked)
    _check_criteria(loaded)
    _check_methods(loaded)
    _check_predictions(loaded)
    check_steps = machine_part(config.machine.kind, "check_steps")
    found: CheckedExperiment = check_steps(loaded, bench, asked, with_margins=with_margins)
    found.warnings.extend(drive_warnings(loaded, asked))
    for number, step in enumerate(config.steps):
        if step.python is not None:
            found.notes.append(
                f"{document.place(('steps', number))}: what '{step.python.function}' of {step.python.file.name} asks "
                f"for can't be known before it runs: neither stability nor limits are checked for it"
            )
    return found


def _check_paths(loaded: LoadedConfig, asked: list[Move]) -> None:
    """Every quantity that a step changes is one of this machine."""
    for move in asked:
        for path in move.after.values.keys() - move.before.values.keys():
            place = loaded.document.place(move.after.place)
            problem = loaded.config.path_problem(path)
            if problem:
                raise UnusableInputError(place, f"expected {problem}")
            if path.startswith("hardware."):
                try:
                    effect_place(loaded.config, path)
                except UnusableValueError as error:
                    raise UnusableInputError(place, str(error)) from error


def _check_methods(loaded: LoadedConfig) -> None:
    """A twin may have one method."""
    kind = loaded.config.machine.kind
    for number, step in enumerate(loaded.config.steps):
        if step.synchronizer is not None and not machine_part(kind, "topology").METHODS:
            place = loaded.document.place(("steps", number, "synchronizer"))
            raise UnusableInputError(
                place, f"a change of the twin's method, expected none: the twin of a {kind} has one method"
            )


def _check_predictions(loaded: LoadedConfig) -> None:
    """A step that is checked by a prediction needs one."""
    config = loaded.config
    for number, step in enumerate(config.steps):
        move = step.ramp or step.set or step.step
        if move is None or move.check is None:
            continue
        place, known = loaded.document.place(("steps", number, step.kind, "check")), foreseeable(config)
        if config.twin.prediction is None:
            text = "'predicted' in a bench that does not look ahead, expected 'prediction: {}' in 'twin:'"
            raise UnusableInputError(place, text)
        if move.path not in known:
            text = f"'predicted' for {move.path}, whose effect no prediction knows, expected it for one of "
            raise UnusableInputError(place, text + ", ".join(known))


def _check_criteria(loaded: LoadedConfig) -> None:
    """Every metric that a criterion bounds is one that a run of this machine may have."""
    config = loaded.config
    known = {**metrics_of(config.machine.kind, config.shape).metrics, **OF_RUNS}
    for number, criterion in enumerate(config.criteria):
        place, problem = loaded.document.place(("criteria", number, "metric")), None
        if find_found_metric(criterion.metric, (config.machine.machine_kind,)) is not None:
            if config.twin.live_diagnosis is None:
                problem = "of a run beside which nothing is diagnosed, expected 'twin: {live_diagnosis: {}}'"
        elif criterion.metric not in known:
            problem = f"is none of this machine{expected_one_of(criterion.metric, known)}"
        if problem:
            raise UnusableInputError(place, f"metric '{criterion.metric}' {problem}")
