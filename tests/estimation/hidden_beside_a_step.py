"""What may be hidden in a line beside a step of E, simulated by other equations than the product's, and what a twin
makes of it whose model has nothing of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from tests.independent_line.line import STEP_OF_E, Hidden, Line, Record, effect

from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.config import ChangepointConfig, SynchronizerConfig
from hilbench.estimation.web_line.offline import Track, run_offline
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording
from hilbench.results.web_line_synchronization import measurements_of, twin_config
from hilbench.runs.figures import ESTIMATE_BAND, overshoot_pct, time_to_stay

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
    return outcome_of(Line(hidden=[*CASES[name], STEP_OF_E]), method, "production", seed=seed, duration_s=duration_s)


def outcome_of(
    line: Line, method: SynchronizerConfig, profile: str, *, seed: int = 0, duration_s: float | None = None
) -> Outcome:
    """What becomes of this line, in which E steps once."""
    record, track = _track(line, method, profile, seed, duration_s)
    t_s, true = record.channels["t_s"], record.truth["E_true_Pa"]
    error = track.E_Pa / true - 1.0
    step = int(np.flatnonzero(np.diff(true))[-1]) + 1
    scored = t_s >= SCORED_FROM_S
    inside = np.abs(track.E_Pa - true) <= 1.96 * track.E_sd_Pa
    return Outcome(
        100.0 * float(error[-1]),
        100.0 * float(track.E_sd_Pa[-1] / true[-1]),
        float(np.mean(inside[scored])),
        time_to_stay(t_s, error, ESTIMATE_BAND, step),
        overshoot_pct(track.E_Pa, true, step),
    )


def _track(
    line: Line, method: SynchronizerConfig, profile: str, seed: int, duration_s: float | None
) -> tuple[Record, Track]:
    """A run of the line, and what a twin makes of it whose model has nothing of what is hidden."""
    record = line.record(profile, seed=seed, duration_s=duration_s)
    data = measurements_of(Recording(record.channels), profile)
    return record, run_offline(ModelParameters.model_validate(line.model), twin_config(method), data)


@dataclass(frozen=True)
class Drawn:
    """A case that was drawn."""

    seed: int
    line: Line
    hidden: tuple[Hidden, ...]  #: beside the step
    profile: str
    duration_s: float

    def __str__(self) -> str:
        sizes = [
            f"{item['effect']} " + ", ".join(f"{value:.3g}" for value in item["parameters"].values())
            for item in self.hidden
        ]
        return f"{'; '.join(sizes) or 'nothing'} ({self.profile}, {self.line.upstream_N:.0f} N)"


def drawn(seed: int) -> Drawn:
    """None, one or two effects of drawn sizes in a drawn machine, in which E steps by 6 to 30 % up or down."""
    rng = np.random.default_rng([seed, 4711])
    tension_N = float(rng.uniform(50.0, 120.0))
    names = rng.choice(sorted(_SIZES), rng.choice([0, 1, 2], p=[0.1, 0.5, 0.4]), replace=False)
    hidden = tuple(_SIZES[str(name)](rng, tension_N) for name in names)
    profile = str(rng.choice(["production", "identification"], p=[0.7, 0.3]))
    duration_s = float(rng.uniform(35.0, 60.0))
    change = float(rng.uniform(0.06, 0.3)) * float(rng.choice([-1.0, 1.0]))
    step = effect("elasticity_step", time_s=float(rng.uniform(0.4, 0.7)) * duration_s, relative_change=change)
    line = Line(
        hidden=[*hidden, step],
        modulus_Pa=float(rng.uniform(2e9, 12e9)),
        length_m=float(rng.uniform(0.6, 2.0)),
        upstream_N=tension_N,
        downstream_N=tension_N * float(rng.uniform(0.7, 1.0)),
        top_share=float(rng.uniform(0.4, 1.2)),
        noise=float(rng.uniform(0.5, 2.0)),
        row_s=float(rng.choice([0.001, 0.002, 0.004])),
    )
    return Drawn(seed, line, hidden, profile, duration_s)


def _either(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high)) * float(rng.choice([-1.0, 1.0]))


@dataclass(frozen=True)
class Accelerated:
    """The mass by which the measured torque of a drawn line accelerates, over the model's, less 1: as it is, as a twin
    has found it, and the deviation that it states."""

    seed: int
    profile: str
    true: float
    found: Nuisance

    @property
    def held(self) -> bool:
        """Whether the 95 % interval holds what is."""
        return abs(self.found.value - self.true) <= 1.96 * self.found.deviation


def accelerated(seed: int) -> Accelerated:
    """Of a line as `drawn` (its machine, profile and step of E), in which inertia and scale of the torque are drawn,
    and beside them, every other time, friction."""
    case, rng = drawn(seed), np.random.default_rng([seed, 99])
    inertia, scale = float(rng.normal(0.0, 0.1)), float(rng.normal(0.0, 0.05))
    hidden = [
        effect("inertia_mismatch", 2, relative_change=inertia),
        effect("torque_scale", 2, relative_change=scale),
    ]
    if seed % 2:
        hidden += [_SIZES[name](rng, 0.5 * case.line.upstream_N) for name in ("coulomb_friction", "viscous_friction")]
    line = replace(case.line, hidden=[*hidden, case.line.hidden[-1]])
    track = _track(line, ChangepointConfig(), case.profile, seed, case.duration_s)[1]
    (found,) = [error for error in track.errors if error.name == "inertia_share"]
    return Accelerated(seed, case.profile, (1.0 + inertia) / (1.0 + scale) - 1.0, found)


#: What may be drawn: sizes that lines have, those of forces in shares of the tension.
_SIZES: dict[str, Callable[[np.random.Generator, float], Hidden]] = {
    "coulomb_friction": lambda rng, f: effect("coulomb_friction", 2, force_N=f * float(rng.uniform(0.03, 0.25))),
    "viscous_friction": lambda rng, f: effect(
        "viscous_friction", 2, coefficient_N_s_per_m=f * float(rng.uniform(0.005, 0.05))
    ),
    "torque_offset": lambda rng, f: effect("torque_offset", 2, offset_Nm=_either(rng, 0.02, 0.12)),
    "torque_scale": lambda rng, f: effect("torque_scale", 2, relative_change=_either(rng, 0.03, 0.12)),
    "inertia_mismatch": lambda rng, f: effect("inertia_mismatch", 2, relative_change=_either(rng, 0.05, 0.2)),
    "web_slip": lambda rng, f: effect("web_slip", creep_per_N=float(rng.uniform(1e-6, 4e-6))),
    "roller_eccentricity": lambda rng, f: effect(
        "roller_eccentricity",
        int(rng.choice([1, 2])),
        amplitude_m=float(rng.uniform(5e-6, 4e-5)),
        phase_rad=float(rng.uniform(-3.0, 3.0)),
    ),
    "unbalance": lambda rng, f: effect(
        "unbalance", 2, amplitude_Nm=float(rng.uniform(0.2, 1.0)), phase_rad=float(rng.uniform(-3.0, 3.0))
    ),
    "torque_ripple": lambda rng, f: effect(
        "torque_ripple",
        2,
        amplitude_Nm=float(rng.uniform(0.04, 0.15)),
        order=float(rng.choice([1.0, 2.0, 6.0])),
        phase_rad=float(rng.uniform(-3.0, 3.0)),
    ),
    "upstream_disturbance": lambda rng, f: effect(
        "upstream_disturbance",
        amplitude_N=f * float(rng.uniform(0.01, 0.05)),
        frequency_Hz=float(rng.uniform(0.2, 1.0)),
        phase_rad=0.0,
    ),
    "strain_offset": lambda rng, f: effect("strain_offset", strain=_either(rng, 2e-6, 8e-6)),
    "stribeck_friction": lambda rng, f: effect(
        "stribeck_friction", 2, force_N=f * float(rng.uniform(0.03, 0.15)), speed_m_s=float(rng.uniform(0.1, 0.5))
    ),
    "load_dependent_friction": lambda rng, f: effect(
        "load_dependent_friction", 2, share=float(rng.uniform(0.01, 0.05))
    ),
}
