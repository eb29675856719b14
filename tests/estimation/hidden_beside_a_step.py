"""What may be hidden in a line beside a step of E, simulated by other equations than the product's, and what a twin
makes of it whose model has nothing of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tests.independent_line.line import STEP_OF_E, Hidden, Line, effect

from hilbench.diagnosis.synchronization import measurements_of, twin_config
from hilbench.estimation.web_line.config import SynchronizerConfig
from hilbench.estimation.web_line.offline import run_offline
from hilbench.plant.web_line.parameters import load_model
from hilbench.results.recording import Recording
from hilbench.runs.figures import ESTIMATE_BAND, overshoot_pct, time_to_stay

#: The line as the twin believes it.
MODEL = Path(__file__).parents[1] / "recordings" / "model.yaml"
#: From here on a twin that has just started is scored, s.
SCORED_FROM_S = 1.0
CASES: dict[str, tuple[Hidden, ...]] = {
    "nothing": (),
    "torque offset 0.05 N·m": (effect("torque_offset", 2, offset_Nm=0.05),),
    "dry friction 5 N": (effect("coulomb_friction", 2, force_N=5.0),),
    "dry friction 20 N": (effect("coulomb_friction", 2, force_N=20.0),),
    "viscous friction 3 N·s/m": (effect("viscous_friction", 2, coefficient_N_s_per_m=3.0),),
    "dry 8 N, viscous 1 N·s/m": (
        effect("coulomb_friction", 2, force_N=8.0),
        effect("viscous_friction", 2, coefficient_N_s_per_m=1.0),
    ),
    "eccentric roller 2, 20 µm": (effect("roller_eccentricity", 2, amplitude_m=20e-6, phase_rad=0.4),),
    "eccentric roller 1, 20 µm": (effect("roller_eccentricity", 1, amplitude_m=20e-6, phase_rad=1.1),),
    "torque scale −10 %": (effect("torque_scale", 2, relative_change=-0.1),),
    "inertia +15 %": (effect("inertia_mismatch", 2, relative_change=0.15),),
    "creep 3e-6 per N": (effect("web_slip", creep_per_N=3e-6),),
    "strain offset 5e-6": (effect("strain_offset", strain=5e-6),),
    "unbalance 0.8 N·m": (effect("unbalance", 2, amplitude_Nm=0.8, phase_rad=0.3),),
    "torque ripple 0.1 N·m": (effect("torque_ripple", 2, amplitude_Nm=0.1, order=2.0, phase_rad=0.7),),
    "upstream tension ±3 N, 0.3 Hz": (
        effect("upstream_disturbance", amplitude_N=3.0, frequency_Hz=0.3, phase_rad=0.0),
    ),
}


@dataclass(frozen=True)
class Outcome:
    """How a run ended, and how honest it was."""

    end_pct: float  #: error of E at the end
    stated_pct: float  #: deviation that the twin states then
    covered: float  #: share of cycles in which ±1.96 stated deviations hold the true E
    time_to_1pct_s: float | None
    overshoot_pct: float | None  #: of the step, beyond the new E

    @property
    def right(self) -> bool:
        """Whether the end is within 1 % or the stated deviation, and the interval holds as often as it says."""
        return abs(self.end_pct) <= max(1.0, self.stated_pct) and self.covered >= 0.93


def outcome(name: str, method: SynchronizerConfig, *, seed: int = 0, duration_s: float | None = None) -> Outcome:
    """One case in production: a ramp, then constant speed, E +20.7 % at 23 s."""
    record = Line(hidden=[*CASES[name], STEP_OF_E]).record("production", seed=seed, duration_s=duration_s)
    data = measurements_of(Recording(record.channels), name)
    track = run_offline(load_model(MODEL), twin_config(method), data)
    true = record.truth["E_true_Pa"]
    error = track.E_Pa / true - 1.0
    step = int(np.flatnonzero(np.diff(true))[-1]) + 1
    scored = data.t_s >= SCORED_FROM_S
    inside = np.abs(track.E_Pa - true) <= 1.96 * track.E_sd_Pa
    return Outcome(
        100.0 * float(error[-1]),
        100.0 * float(track.E_sd_Pa[-1] / true[-1]),
        float(np.mean(inside[scored])),
        time_to_stay(data.t_s, error, ESTIMATE_BAND, step),
        overshoot_pct(track.E_Pa, true, step),
    )
