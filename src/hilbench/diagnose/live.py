"""The gap on a running bench: the twin with the original and with the extended model on the same hidden mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hilbench.errors import UnusableInputError
from hilbench.experiment.config import ExperimentConfig, LoadedConfig
from hilbench.record.recording import Recording, read_recording
from hilbench.record.run import RunOutcome, run_experiment
from hilbench.web.parameters import ModelParameters

#: The line's share of its highest speed above which it counts as working.
_WORKS = 0.2


@dataclass(frozen=True)
class LiveGap:
    """How well the twin did in one run, while the line worked."""

    run: Path
    torque_residual_rms_Nm: float
    tension_error_rms_N: float  #: true tension less set-point, the loop closed
    tension_deviation_mean_N: float  #: simulated less true tension
    E_bias_pct: float  #: mean of estimate over truth, less 1


def run_bench(loaded: LoadedConfig, model: ModelParameters | None, out: Path) -> RunOutcome:
    """Run a bench config, the twin with another model if one is given. Raises as `run_experiment`."""
    if model is not None:
        data = loaded.config.model_dump()
        data["model"] = model.model_dump()
        loaded = LoadedConfig(ExperimentConfig.model_validate(data), loaded.document)
    return run_experiment(loaded, out)


def live_gap(outcome: RunOutcome) -> LiveGap:
    """Judge a run. Raises UnusableInputError for one that ended before it had a recording."""
    if not outcome.recorded:
        faults = "; ".join(fault.text for fault in outcome.result.faults)
        raise UnusableInputError(outcome.folder.path, f"the run has no recording ({faults}), expected a whole run")
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
        torque_residual_rms_Nm=rms(_signal(recording, "tau2_residual_Nm")),
        tension_error_rms_N=rms(true_N - _signal(recording, "F_ref_N")),
        tension_deviation_mean_N=float(np.mean((sim_N - true_N)[works])),
        E_bias_pct=100.0 * float(np.mean(ratio[works]) - 1.0),
    )


def _signal(recording: Recording, name: str) -> np.ndarray:
    return np.asarray(recording[name], np.float64)
