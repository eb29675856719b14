"""The gap on a running bench: the twin with the original and with the extended model on the same hidden mechanics."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.bench.bench import CycleObserver, InterruptedByOperatorError
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_INTERRUPTED, BenchFaultError, UnusableInputError
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import ExperimentConfig, LoadedConfig

#: The line's share of its highest speed above which it counts as working.
_WORKS = 0.2


@dataclass(frozen=True)
class LiveGap:
    """How well the twin did in one run, while the line worked."""

    run: Path
    cycles: int  #: length of the whole run
    torque_residual_rms_Nm: float
    tension_error_rms_N: float  #: true tension less set-point, the loop closed
    tension_deviation_mean_N: float  #: simulated less true tension
    E_bias_pct: float  #: mean of estimate over truth, less 1


def run_bench(
    loaded: LoadedConfig,
    model: ModelParameters,
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
    outcome = run_experiment(loaded, out, observers=observers, announce=announce)
    said = f"{outcome.folder.path}: {'; '.join(fault.text for fault in outcome.result.faults)}"
    if outcome.exit_code == EXIT_INTERRUPTED:
        raise InterruptedByOperatorError(said)
    if outcome.exit_code == EXIT_BENCH_FAULT:
        raise BenchFaultError(said)
    return outcome


def live_gap(outcome: RunOutcome) -> LiveGap:
    """Judge a run. Raises UnusableInputError for one that is too short for a recording."""
    if not outcome.recorded:
        raise UnusableInputError(outcome.folder.path, "the run has no recording, expected steps that take time")
    recording = read_recording(outcome.folder.recording)
    speed = _signal(recording, "v2_cmd_m_s")
    works = (speed > _WORKS * speed.max()) & (_signal(recording, "loop_closed") > 0.5)
    if not works.any():
        works = speed > _WORKS * speed.max()

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(values[works] ** 2)))

    true_N, sim_N = _signal(recording, "F_true_N"), _signal(recording, "F_sim_N")
    ratio = _signal(recording, "E_sim_Pa") / _signal(recording, "E_true_Pa")
    return LiveGap(
        run=outcome.folder.path,
        cycles=len(recording),
        torque_residual_rms_Nm=rms(_signal(recording, "tau2_residual_Nm")),
        tension_error_rms_N=rms(true_N - _signal(recording, "F_ref_N")),
        tension_deviation_mean_N=float(np.mean((sim_N - true_N)[works])),
        E_bias_pct=100.0 * float(np.mean(ratio[works]) - 1.0),
    )


def _signal(recording: Recording, name: str) -> np.ndarray:
    return np.asarray(recording[name], np.float64)
