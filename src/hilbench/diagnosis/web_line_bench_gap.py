"""The gap on a running bench: the twin with the original and with the extended model on the same hidden mechanics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from hilbench.bench.bench import CycleObserver, InterruptedByOperatorError
from hilbench.diagnosis.noise import rms
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED, BenchFaultError, UnusableInputError
from hilbench.plant.model_file import Machine
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import ExperimentConfig, LoadedConfig


@dataclass(frozen=True)
class LiveGap:
    """Prediction errors of the twin in one run."""

    run: Path
    cycles: int  #: length of the whole run
    figures: tuple[LiveFigure, ...]


def run_bench(
    loaded: LoadedConfig,
    model: Machine,
    out: Path,
    *,
    more_steps: Sequence[Mapping[str, Any]] = (),
    observers: Sequence[CycleObserver] = (),
    announce: Callable[[str], None] = lambda text: None,
) -> RunOutcome:
    """Run a bench config to its end, the twin with `model`; its criteria may fail.

    more_steps: as they stand in YAML, run after those of the config.

    Raises InterruptedByOperatorError and BenchFaultError, with the folder of the run, for one that was cut short: what
    such a run shows is no experiment; UnusableInputError as `run_experiment`.
    """
    data = loaded.config.model_dump()
    data["machine"] = model.model_dump()
    data["steps"] = [*(data["steps"] or ()), *more_steps]
    loaded = LoadedConfig(ExperimentConfig.model_validate(data), loaded.document)
    return completed(run_experiment(loaded, out, observers=observers, announce=announce))


def completed(outcome: RunOutcome) -> RunOutcome:
    """The outcome of a run to its end. Raises as `run_bench` for one that was cut short."""
    problem_text = f"{outcome.folder.path}: {'; '.join(fault.text for fault in outcome.result.faults)}"
    if outcome.exit_code == EXIT_INTERRUPTED:
        raise InterruptedByOperatorError(problem_text)
    if outcome.exit_code == EXIT_BENCH_FAULT:
        raise BenchFaultError(problem_text)
    return outcome


def live_gap(outcome: RunOutcome) -> LiveGap:
    """Judge a run. Raises UnusableInputError for one that is too short for a recording."""
    if not outcome.recorded:
        raise UnusableInputError(outcome.folder.path, "the run has no recording, expected steps that take time")
    recording = read_recording(outcome.folder.recording)
    figures = _of_a_shaft(recording) if "x1_rad" in recording else figures_of_line(recording)
    return LiveGap(outcome.folder.path, len(recording), figures)


def _of_a_shaft(recording: Recording) -> tuple[LiveFigure, ...]:
    speed = np.abs(signal(recording, "v1_cmd_rad_s"))
    works = speed > WORKS * speed.max()
    ratio = signal(recording, "J_sim_kg_m2") / signal(recording, "J_true_kg_m2")
    error_rad_s = signal(recording, "v1_cmd_rad_s") - signal(recording, "v1_rad_s")
    friction_Nm = signal(recording, "coulomb_sim_Nm") - signal(recording, "coulomb_true_Nm")
    residual_Nm = signal(recording, "tau1_residual_Nm")
    friction_mean_Nm, bias = float(np.mean(friction_Nm[works])), float(np.mean(ratio[works]) - 1.0)
    figures = (
        ("torque_residual_rms_Nm", "torque residual, rms, N·m", rms(residual_Nm[works])),
        ("speed_error_rms_rad_s", "speed less its command, rms, rad/s", rms(error_rad_s[works])),
        ("friction_deviation_mean_Nm", "estimated less emulated dry friction, mean, N·m", friction_mean_Nm),
        ("J_bias_pct", "bias of the inertia, %", 100.0 * bias),
    )
    return tuple(LiveFigure(*figure) for figure in figures)


#: Share of its highest speed above which a machine counts as working.
WORKS: Final = 0.2


@dataclass(frozen=True)
class LiveFigure:
    """One figure of a run."""

    name: str  #: with its unit, as `--json` prints it
    text: str  #: with its unit, for a person
    value: float


def signal(recording: Recording, name: str) -> np.ndarray:
    """(n,): a channel as numbers. Raises KeyError for one that is not there."""
    return np.asarray(recording[name], np.float64)


def figures_of_line(recording: Recording) -> tuple[LiveFigure, ...]:
    """Figures of the one span, or of each of several by its number."""
    if "F_true_N" in recording:
        return _of_a_span(recording, 1, "")
    spans = [span for span in range(1, len(recording.channels)) if f"F{span}_true_N" in recording]
    if any(f"F{span}_sim_N" not in recording for span in spans):
        return _with_stations(recording, [span for span in spans if f"F{span}_sim_N" in recording])
    return tuple(figure for span in spans for figure in _of_a_span(recording, span, str(span)))


def _with_stations(recording: Recording, spans: list[int]) -> tuple[LiveFigure, ...]:
    """Figures of a line of which the twin publishes one span of each section between two axes: `spans`."""
    axes = [axis for axis in range(1, len(recording.channels)) if f"v{axis}_cmd_m_s" in recording]
    speed = signal(recording, f"v{axes[-1]}_cmd_m_s")
    works, figures = speed > WORKS * speed.max(), []
    for axis in axes:
        if f"tau{axis}_residual_Nm" in recording:
            residual_Nm = rms(signal(recording, f"tau{axis}_residual_Nm")[works])
            name = f"torque_residual_axis{axis}_rms_Nm"
            figures.append(LiveFigure(name, f"torque residual of axis {axis}, rms, N·m", residual_Nm))
    for span in spans:
        off_N = signal(recording, f"F{span}_sim_N") - signal(recording, f"F{span}_true_N")
        text = f"simulated less true tension of span {span}, mean, N"
        figures.append(LiveFigure(f"tension{span}_deviation_mean_N", text, float(np.mean(off_N[works]))))
    return tuple(figures)


def _of_a_span(recording: Recording, span: int, number: str) -> tuple[LiveFigure, ...]:
    """`number`: as names have it; "" where there is one span."""
    behind, where = span + 1, f" of span {number}" if number else ""
    speed = signal(recording, f"v{behind}_cmd_m_s")
    works = speed > WORKS * speed.max()
    if f"loop{number}_closed" in recording:
        closed = works & (signal(recording, f"loop{number}_closed") > 0.5)
        works = closed if closed.any() else works
    true_N, sim_N = signal(recording, f"F{number}_true_N"), signal(recording, f"F{number}_sim_N")
    ratio = signal(recording, f"E{number}_sim_Pa") / signal(recording, f"E{number}_true_Pa")
    residual_Nm = signal(recording, f"tau{behind}_residual_Nm")
    behind_it = f" of axis {behind}" if number else ""
    figures = [(f"torque_residual{number}_rms_Nm", f"torque residual{behind_it}, rms, N·m", rms(residual_Nm[works]))]
    if f"F{number}_ref_N" in recording:
        error_N = true_N - signal(recording, f"F{number}_ref_N")
        figures.append(
            (f"tension{number}_error_rms_N", f"true tension less set-point{where}, rms, N", rms(error_N[works]))
        )
    deviation_N = float(np.mean((sim_N - true_N)[works]))
    figures.append((f"tension{number}_deviation_mean_N", f"simulated less true tension{where}, mean, N", deviation_N))
    figures.append((f"E{number}_bias_pct", f"bias of E{where}, %", 100.0 * float(np.mean(ratio[works]) - 1.0)))
    return tuple(LiveFigure(*figure) for figure in figures)
