"""Shifts of the independent line through a twin's estimator, beside the best that could be known: cases and scores.

The line keeps its tension by a sensor of its own, so only the estimate of E is judged. What is hidden is in the line
alone: the twin's model has nothing of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from tests.estimation.best_estimator import ANY, WANDERS_S, Jumps, best_deviation, states_of
from tests.estimation.shift_score import AFTER_STEP_S, MOVES_M_S, EstimateScore, behind, shares_of_steps
from tests.independent_line import Record, effect
from tests.independent_line import shift as profiles
from tests.independent_line.line import Hidden, Line

from hilbench.estimation.web_line.config import ModelErrorsConfig, SynchronizerConfig
from hilbench.estimation.web_line.offline import Track, run_offline
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording
from hilbench.results.web_line_synchronization import measurements_of, twin_config

#: From here on a twin that has just started is scored, s.
SCORED_FROM_S = 1.0
_OFFSET = effect("torque_offset", 2, offset_Nm=0.05)
_DRY = effect("coulomb_friction", 2, force_N=6.0)
_VISCOUS = effect("viscous_friction", 2, coefficient_N_s_per_m=2.0)
_SCALE = effect("torque_scale", 2, relative_change=-0.07)
_INERTIA = effect("inertia_mismatch", 2, relative_change=0.1)
_CREEP = effect("web_slip", creep_per_N=3e-6)
_ECCENTRIC = effect("roller_eccentricity", 2, amplitude_m=20e-6, phase_rad=0.4)
_UNBALANCE = effect("unbalance", 2, amplitude_Nm=0.8, phase_rad=0.3)
_RIPPLE = effect("torque_ripple", 2, amplitude_Nm=0.1, order=2.0, phase_rad=0.7)
_DELAY = effect("torque_delay", 2, delay_s=0.004)
_SWAY = effect("upstream_disturbance", amplitude_N=3.0, frequency_Hz=0.3, phase_rad=0.0)
#: What may be hidden: alone, then in pairs. Those of the name `warms up` have friction that is lost in minutes.
HIDDEN: Mapping[str, tuple[Hidden, ...]] = {
    "nothing": (),
    "offset": (_OFFSET,),
    "dry friction": (_DRY,),
    "viscous friction": (_VISCOUS,),
    "friction warms up": (_DRY, _VISCOUS),
    "scale": (_SCALE,),
    "inertia": (_INERTIA,),
    "creep": (_CREEP,),
    "eccentric roller 2": (_ECCENTRIC,),
    "eccentric roller 1": (effect("roller_eccentricity", 1, amplitude_m=20e-6, phase_rad=1.1),),
    "unbalance": (_UNBALANCE,),
    "ripple": (_RIPPLE,),
    "delay": (_DELAY,),
    "upstream sways": (_SWAY,),
    "offset, dry friction": (_OFFSET, _DRY),
    "offset, creep": (_OFFSET, _CREEP),
    "dry friction, creep": (_DRY, _CREEP),
    "dry friction, eccentric roller 2": (_DRY, _ECCENTRIC),
    "dry friction, upstream sways": (_DRY, _SWAY),
    "scale, inertia": (_SCALE, _INERTIA),
    "scale, creep": (_SCALE, _CREEP),
    "inertia, delay": (_INERTIA, _DELAY),
    "unbalance, ripple": (_UNBALANCE, _RIPPLE),
    "eccentric roller 2, upstream sways": (_ECCENTRIC, _SWAY),
    "friction warms up, offset": (_DRY, _VISCOUS, _OFFSET),
}


@dataclass(frozen=True)
class ShiftCase:
    """One shift: how the line runs, how E goes, what is hidden."""

    profile: str
    modulus: str
    hidden: str = "nothing"

    @property
    def name(self) -> str:
        """Unique among the cases."""
        return f"{self.profile} / {self.modulus} / {self.hidden}"

    @property
    def warms_up(self) -> bool:
        """Whether its friction does."""
        return "warms up" in self.hidden

    @property
    def known(self) -> Jumps:
        """What the best estimator knows of the course of E."""
        match self.modulus:
            case "steps":
                return Jumps(tuple(time_s for time_s, _ in profiles.STEPS))
            case "drift":
                return Jumps(drift_s=profiles.DRIFT_S)
            case "slow_drift":
                return Jumps(drift_s=(0.0, 1e9))
            case _:
                return Jumps()


#: The scoreboard: a right model in every course of E; each effect in a changing and in a steady shift, pairs in the
#: former.
CASES: tuple[ShiftCase, ...] = (
    *(ShiftCase(profile, modulus) for profile in profiles.PROFILES for modulus in profiles.MODULI),
    *(ShiftCase("stops", "steps", hidden) for hidden in HIDDEN if hidden != "nothing"),
    *(ShiftCase("steady", "drift", hidden) for hidden in HIDDEN if hidden != "nothing" and ", " not in hidden),
)


@dataclass(frozen=True)
class OfflineOutcome:
    """How a method did in a shift, in % of E; over the cycles in motion, 1 s behind each true step left out."""

    name: str
    method: str
    worst_pct: float
    within_pct: float  #: of the cycles, within 1 %
    held_pct: float  #: of the cycles, by the 95 % interval
    half_pct: float  #: median half width of that
    best_pct: float  #: the same of the best estimator that knows what is hidden
    any_pct: float  #: and of the one that allows for whatever may be
    cpu_us: float  #: a cycle

    @property
    def figures(self) -> dict[str, float]:
        """The numbers alone, by name."""
        return {name: value for name, value in asdict(self).items() if name not in ("name", "method")}

    @property
    def ratio(self) -> float:
        """Half width over that of the best estimator that allows for whatever may be.

        None can be as sure as one that knows which effects are there: an offset that nothing shows is in no data.
        """
        return self.half_pct / self.any_pct


def recorded(case: ShiftCase, duration_s: float = profiles.SHIFT_S, seed: int = 1) -> tuple[Line, Record]:
    """The line of a case, and what it has recorded."""
    line = profiles.shift_line(HIDDEN[case.hidden])
    courses = profiles.courses(case.profile, case.modulus, duration_s, seed=seed, warms_up=case.warms_up)
    return line, line.record_courses(courses, seed)


def estimated(line: Line, record: Record, method: SynchronizerConfig) -> Track:
    """What a twin whose model has nothing of what is hidden makes of it."""
    data = measurements_of(Recording(record.channels), "the independent line")
    return run_offline(ModelParameters.model_validate(line.model), twin_config(method), data)


def scored_rows(record: Record, row_s: float) -> NDArray[np.bool_]:
    """The rows that count, (n,)."""
    after_steps = behind(shares_of_steps(record.truth["E_true_Pa"]), round(AFTER_STEP_S / row_s))
    moves = np.abs(record.truth["v2_true_m_s"]) > MOVES_M_S
    return np.asarray(moves & ~after_steps & (record.channels["t_s"] >= SCORED_FROM_S))


def outcomes(
    case: ShiftCase,
    methods: Mapping[str, SynchronizerConfig],
    *,
    duration_s: float = profiles.SHIFT_S,
    seed: int = 1,
) -> list[OfflineOutcome]:
    """A case with each method; the shift is simulated once."""
    line, record = recorded(case, duration_s, seed)
    counts, true = scored_rows(record, line.row_s), record.truth["E_true_Pa"]
    friction_s = profiles.WARM_UP_S if case.warms_up else WANDERS_S
    errors = ModelErrorsConfig()
    widths = []
    for states in (states_of(line), tuple(dict.fromkeys([*ANY, *states_of(line)]))):
        deviation = best_deviation(record, line, errors, case.known, states=states, friction_s=friction_s)
        best = EstimateScore()
        best.add(true, deviation * line.modulus_Pa, true, counts)
        widths.append(best.half_width_pct)
    found = []
    for name, method in methods.items():
        track, score = estimated(line, record, method), EstimateScore()
        score.add(track.E_Pa, track.E_sd_Pa, true, counts)
        figures = (score.worst_pct, score.within_pct, score.held_pct, score.half_width_pct, widths[0], widths[1])
        found.append(OfflineOutcome(case.name, name, *figures, track.synchronizer_us or float("nan")))
    return found
