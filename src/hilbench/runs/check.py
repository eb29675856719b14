"""Checks of a config and its experiment before anything starts, and warnings for the operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite

from hilbench.bench.check import CheckedBench, check_bench
from hilbench.bench.prediction.create import foreseeable
from hilbench.bench.tasks.tension_loop import Margins, OperatingPoint, TensionLoop
from hilbench.bench.web_line_check import check_stability, operating_point_text, stiffness_reserves
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError, UnusableValueError
from hilbench.exchange.effect_objects import effect_place
from hilbench.plant.effect import MachineKind
from hilbench.runs.config import ExperimentConfig, LoadedConfig
from hilbench.runs.drive_check import drive_warnings
from hilbench.runs.estimated_errors import find_metric as find_found_metric
from hilbench.runs.metrics import OF_RUNS, metrics_of
from hilbench.runs.set_point_schedule import Move, moves
from hilbench.runs.web_line_check import operating_points, step_warnings, stiffness_of

#: Margins below which a loop is noted.
_LEAST_GAIN, _LEAST_PHASE_DEG = 2.0, 30.0


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
    if config.machine_kind is MachineKind.SERVO_AXIS:
        from hilbench.runs.servo_axis_check import check_shaft  # machine code that no web line needs

        warnings, reserve = check_shaft(loaded, asked)
        found = CheckedExperiment(bench, None, None, warnings, list(bench.notes), inertia_reserve=reserve)
    else:
        found = _check_web(loaded, bench, asked, with_margins=with_margins)
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
    """The twin of a shaft has one method."""
    kind = loaded.config.machine_kind
    for number, step in enumerate(loaded.config.steps):
        if step.synchronizer is not None and kind is MachineKind.SERVO_AXIS:
            place = loaded.document.place(("steps", number, "synchronizer"))
            raise UnusableInputError(
                place, f"a change of the twin's method, expected none: the twin of a {kind} has one method"
            )


def _check_predictions(loaded: LoadedConfig) -> None:
    """A step that is checked by a prediction needs one."""
    config, place = loaded.config, loaded.document.place
    for number, step in enumerate(config.steps):
        move = step.ramp or step.set or step.step
        if move is None or move.check is None:
            continue
        if config.twin.prediction is None:
            raise UnusableInputError(
                place(("steps", number, step.kind, "check")),
                "'predicted' in a bench that does not look ahead, expected 'prediction: {}' in 'twin:'",
            )
        if move.path not in foreseeable(config):
            raise UnusableInputError(
                place(("steps", number, step.kind, "check")),
                f"'predicted' for {move.path}, whose effect no prediction knows, expected it for one of "
                f"{', '.join(foreseeable(config))}",
            )


def _check_criteria(loaded: LoadedConfig) -> None:
    """Every metric that a criterion bounds is one that a run of this machine may have."""
    config = loaded.config
    known = {**metrics_of(config.machine_kind, config.shape).metrics, **OF_RUNS}
    for number, criterion in enumerate(config.criteria):
        if find_found_metric(criterion.metric, (config.machine_kind,)) is not None:
            if config.twin.live_diagnosis is None:
                raise UnusableInputError(
                    loaded.document.place(("criteria", number, "metric")),
                    f"metric '{criterion.metric}' of a run beside which nothing is diagnosed, expected 'twin: "
                    "{live_diagnosis: {}}'",
                )
            continue
        if criterion.metric not in known:
            raise UnusableInputError(
                loaded.document.place(("criteria", number, "metric")),
                f"metric '{criterion.metric}' is none of this machine{expected_one_of(criterion.metric, known)}",
            )


def _check_web(
    loaded: LoadedConfig, bench: CheckedBench, asked: list[Move], *, with_margins: bool
) -> CheckedExperiment:
    """Web, drives, bus and twin are stable wherever the steps bring them."""
    config, document = loaded.config, loaded.document
    places = operating_points(config, asked)
    for point, place in places.items():
        check_stability(config, document, point, place if len(place) > 1 else ("machine", "web"))
    reserves = stiffness_reserves(config, max(places, key=stiffness_of))
    reserve = min(reserves.values(), default=inf)
    stations = config.shape.has_stations
    worst = _worst(config, list(places)) if with_margins and not stations else None
    warnings = list(step_warnings(loaded, asked))
    notes = list(bench.notes)
    if worst is not None and (worst.margins.gain < _LEAST_GAIN or worst.margins.phase_deg < _LEAST_PHASE_DEG):
        warnings.append(
            f"the tension loop rings: {worst}, expected at least {_LEAST_GAIN:g} and {_LEAST_PHASE_DEG:g}°, by a "
            f"smaller bandwidth_rad_per_s of the controllers, more swing_damping_ratio or a shorter cycle"
        )
    if stations:
        notes.append(
            "how stable the tension loops are is not looked at: idlers, dancers and accumulators swing beside the "
            "driven rollers"
        )
    if reserve < 1.0:
        notes.append(
            "the load motor emulates so stiff a web only with the active damping of axis 1 (swing_damping_ratio)"
        )
    named = {config.load_motor_of(axis): value for axis, value in reserves.items()}
    return CheckedExperiment(bench, reserve, worst, warnings, notes, stiffness_reserves=named)


# -- stability ---------------------------------------------------------------------------------------------------------


def _worst(config: ExperimentConfig, points: list[OperatingPoint]) -> Worst:
    found = [Worst(point, TensionLoop(config, point).margins) for point in points]
    return min(found, key=lambda one: min(one.margins.gain / _LEAST_GAIN, one.margins.phase_deg / _LEAST_PHASE_DEG))
