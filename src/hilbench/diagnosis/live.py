"""The gap on a running bench: the twin with the original and with the extended model on the same hidden mechanics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.bench.bench import CycleObserver, InterruptedByOperatorError
from hilbench.diagnosis.live_figure import WORKS, LiveFigure, signal
from hilbench.diagnosis.noise import rms
from hilbench.diagnosis.web_line.bench_figures import figures_of_line
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
    return (
        LiveFigure("torque_residual_rms_Nm", "torque residual, rms, N·m", rms(residual_Nm[works])),
        LiveFigure("speed_error_rms_rad_s", "speed less its command, rms, rad/s", rms(error_rad_s[works])),
        LiveFigure(
            "friction_deviation_mean_Nm",
            "estimated less emulated dry friction, mean, N·m",
            float(np.mean(friction_Nm[works])),
        ),
        LiveFigure("J_bias_pct", "bias of the inertia, %", 100.0 * float(np.mean(ratio[works]) - 1.0)),
    )
