"""How often the diagnosis is right, on blind data.

    diagnose_scoreboard.py [--seeds N] [--what single,pair,nothing,unknown] [--duration S] [--json FILE]

Every effect of the vocabulary at every axis and three sizes; pairs; nothing at all; unknowns. An effect counts as
visible when the true parameters raise the log likelihood of the torques by more than 50. Prints the shares, and what
was named for what was hidden where that was wrong.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hilbench.diagnose.blind import UNKNOWNS, blind_recording
from hilbench.diagnose.diagnosis import diagnose
from hilbench.diagnose.measured import measured_from
from hilbench.diagnose.predictor import FreeRun
from hilbench.web import layout as lay
from hilbench.web.effects import EFFECTS, Effect
from hilbench.web.parameters import EffectEntry, ModelParameters

DEMONSTRATOR: dict[str, Any] = {
    "web": {"youngs_modulus_Pa": 8.7e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0},
    "rollers": {"radius_m": 0.2, "inertia_kg_m2": 1.167, "gear_ratio": 5.0},
    "motors": {"inertia_kg_m2": 0.001},
    "drives": {
        "velocity_kp_Nm_s_per_rad": 1.5,
        "velocity_ki_Nm_per_rad": 30.0,
        "torque_limit_Nm": 9.0,
        "current_loop_time_constant_s": 0.001,
        "sample_time_s": 0.001,
    },
    "boundary": {"upstream_tension_N": 80.0, "downstream_tension_N": 70.0},
}
SIZES = (0.25, 1.0, 3.0)  #: of the scale that the vocabulary gives
VISIBLE = 50.0


@dataclass
class Case:
    """What is hidden, and what was found."""

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    unknown: tuple[str, float] | None = None
    visible: bool = True
    verdict: str = ""
    found: list[list[Any]] = field(default_factory=list)
    tied: list[list[str]] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    ratio: float = 0.0
    problem: str = ""


def entry(effect: Effect, axis: int | None, size: float, rng: np.random.Generator, duration_s: float) -> dict[str, Any]:
    """An effect of that size; what shapes it at random."""
    values: dict[str, float] = {}
    for parameter in effect.parameters:
        if parameter.name in effect.strength:
            sign = rng.choice([-1.0, 1.0]) if parameter.lower < 0.0 else 1.0
            values[parameter.name] = float(sign * size * parameter.scale)
        elif parameter.name == "phase_rad":
            values[parameter.name] = float(rng.uniform(-3.0, 3.0))
        elif parameter.name == "order":
            values[parameter.name] = float(rng.choice([1.0, 2.0, 6.0]))
        elif parameter.name == "frequency_Hz":
            values[parameter.name] = float(rng.uniform(0.3, 3.0))
        elif parameter.name == "time_s":
            values[parameter.name] = float(rng.uniform(0.2, 0.8) * duration_s)
        elif parameter.name == "speed_m_s":
            values[parameter.name] = float(rng.uniform(0.15, 0.6))
    return {"effect": effect.id, "axis": axis, "parameters": values}


def places() -> list[tuple[Effect, int | None]]:
    """Every effect at every place."""
    return [(effect, axis) for effect in EFFECTS for axis in ((1, 2) if effect.per_axis else (None,))]


def cases(what: list[str], seeds: int, duration_s: float) -> list[Case]:
    """All cases asked for."""
    made = []
    for seed in range(seeds):
        rng = np.random.default_rng([7, seed])
        if "single" in what:
            for effect, axis in places():
                made += [Case("single", seed, [entry(effect, axis, s, rng, duration_s)]) for s in SIZES]
        if "pair" in what:
            options = places()
            for _ in range(10):
                a, b = rng.choice(len(options), 2, replace=False)
                hidden = [entry(options[k][0], options[k][1], 1.0, rng, duration_s) for k in (int(a), int(b))]
                made.append(Case("pair", seed, hidden))
        if "nothing" in what:
            made += [Case("nothing", 1000 * seed + k, []) for k in range(5)]
        if "unknown" in what:
            made += [Case("unknown", seed, [], (name, s)) for name, (_, sizes) in UNKNOWNS.items() for s in sizes]
    return made


def run(task: tuple[Case, float]) -> Case:
    """Make the recording, diagnose, compare."""
    case, duration_s = task
    model = ModelParameters.model_validate(DEMONSTRATOR)
    effects = [EffectEntry.model_validate(item) for item in case.hidden]
    recording = blind_recording(model, effects, duration_s=duration_s, seed=case.seed, unknown=case.unknown)
    data = measured_from(recording, model, "blind")
    predictor = FreeRun(model, data)
    plain = predictor.measured - predictor.predict(lay.pack(model))[0]
    if case.hidden:
        true = predictor.measured - predictor.predict(lay.pack(model.with_effects(*effects)))[0]
        gain = sum(np.sum(plain[k] ** 2 - true[k] ** 2) / (2.0 * 0.05**2) for k in (0, 1))
        case.visible = bool(gain > VISIBLE)
    try:
        found = diagnose(recording, model, "blind")
    except Exception as error:  # a case that fails is a row of the table, not the end of the run
        case.problem = f"{type(error).__name__}: {error}"
        return case
    case.verdict = found.verdict
    case.found = [[e.effect, e.axis] for e in found.effects]
    case.tied = [e.tied_with for e in found.effects]
    case.ratio = max(gap.after / gap.noise_floor for gap in found.gaps)
    for e in found.effects:
        match = [item for item in case.hidden if (item["effect"], item["axis"]) == (e.effect, e.axis)]
        for name, value in e.parameters.items():
            if match and name in match[0]["parameters"]:
                case.covered.append(value.ci95[0] <= match[0]["parameters"][name] <= value.ci95[1])
    return case


def right(case: Case) -> bool:
    """Whether what was named is what was hidden."""
    hidden = sorted([item["effect"], item["axis"] or 0] for item in case.hidden)
    found = sorted([effect, axis or 0] for effect, axis in case.found)
    if case.kind == "unknown":
        return case.verdict == "unknown"
    return hidden == found and case.verdict == ("named" if hidden else "complete")


def summary(done: list[Case]) -> str:
    """Shares by kind, and what was wrong."""
    lines = ["| kind | cases | visible | right | % |", "|---|--:|--:|--:|--:|"]
    for kind in ("single", "pair", "nothing", "unknown"):
        mine = [case for case in done if case.kind == kind]
        seen = [case for case in mine if case.visible]
        if mine:
            good = sum(map(right, seen))
            lines.append(f"| {kind} | {len(mine)} | {len(seen)} | {good} | {100.0 * good / max(len(seen), 1):.1f} |")
    covered = [c for case in done if right(case) for c in case.covered]
    ratios = [case.ratio for case in done if case.kind in ("single", "pair") and right(case)]
    if covered:
        lines.append(f"\n95 % intervals hold the true value in {100.0 * np.mean(covered):.1f} % of {len(covered)}")
        lines.append(f"held-out rms over the floor: largest {max(ratios):.3f}")
    wrong = Counter(
        f"{[(i['effect'], i['axis'], _strength(i)) for i in c.hidden] or c.unknown or 'nothing'}"
        f" → {c.verdict} {c.found} {c.problem}"
        for c in done
        if c.visible and not right(c)
    )
    return "\n".join([*lines, "", *(f"{text} ({count})" for text, count in sorted(wrong.items()))])


def _strength(item: dict[str, Any]) -> float:
    return float(next(iter(item["parameters"].values())))


def main() -> None:
    """Run on all cores and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--what", default="single,pair,nothing,unknown")
    parser.add_argument("--duration", type=float, default=66.0, help="length of each recording, s")
    parser.add_argument("--json", type=Path, help="also write every case")
    options = parser.parse_args()
    tasks = [(case, options.duration) for case in cases(options.what.split(","), options.seeds, options.duration)]
    with ProcessPoolExecutor() as pool:
        done = list(pool.map(run, tasks))
    print(summary(done))
    if options.json:
        options.json.write_text(json.dumps([asdict(case) for case in done], indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
