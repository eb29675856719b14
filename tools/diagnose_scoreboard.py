"""How often the diagnosis is right, on blind data.

    diagnose_scoreboard.py [--seeds N] [--first-seed N] [--what single,pair,nothing,unknown] [--duration S] [--machines]
                           [--cases FILE] [--docs FILE]

Every effect of the vocabulary at every axis and three sizes; pairs; nothing at all; unknowns. What is hidden counts as
visible when knowing it raises the log likelihood of torques and positions by more than 50, of a pair each beside the
other. With `--machines` each case has a machine of its own: width, thickness, span, inertia, tension, speed and noise.
Prints the shares, and what was named for what was hidden where that was wrong. `--cases` keeps each finished case in a
line of that file, and takes those that are there already as done; `--docs` writes the table into the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import zlib
from collections import Counter
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # simulated data lie with the tests

import docs_page
import finished_cases
import numpy as np
from tests.simulated_recordings import UNKNOWNS, hidden_recording

from hilbench.diagnosis.diagnosis import Value, diagnose
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.plant.effect import Effect, MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes
from hilbench.results.recording import Recording

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
TOP_M_S = 4.0
SIZES = (0.25, 1.0, 3.0)  #: of what the vocabulary says is usual on the demonstrator
VISIBLE = 50.0


@dataclass
class Case:
    """What is hidden, and what was found."""

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    unknown: tuple[str, float] | None = None
    duration_s: float = 66.0
    machine: bool = False  #: one of its own
    visible: bool = True
    verdict: str = ""
    found: list[list[Any]] = field(default_factory=list)
    tied: list[list[str]] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    ratio: float = 0.0
    problem: str = ""
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """What tells it from others."""
        return json.dumps([self.kind, self.seed, self.hidden, self.unknown, self.duration_s, self.machine])


def entry(effect: Effect, axis: int | None, size: float, rng: np.random.Generator, duration_s: float) -> dict[str, Any]:
    """An effect of that size, or the first part of one that has several; what shapes it at random."""
    values: dict[str, float] = {}
    sizes = machine_sizes(ModelParameters.model_validate(DEMONSTRATOR), axis, top_speed_m_s=TOP_M_S)
    for parameter in effect.parameters:
        if parameter.name == effect.strength[0]:
            sign = rng.choice([-1.0, 1.0]) if parameter.lower < 0.0 else 1.0
            values[parameter.name] = float(sign * size * parameter.size.on(sizes))
        elif parameter.name == "phase_rad":
            values[parameter.name] = float(rng.uniform(-3.0, 3.0))
        elif parameter.name == "order":
            values[parameter.name] = float(rng.choice([1.0, 2.0, 6.0]))
        elif parameter.name == "frequency_Hz":
            values[parameter.name] = float(rng.uniform(0.3, 3.0))
        elif parameter.name == "time_s":
            values[parameter.name] = float(rng.uniform(0.2, 0.8) * duration_s)
        elif parameter.name == "duration_s":
            values[parameter.name] = float(rng.uniform(0.05, 0.2) * duration_s)
        elif parameter.name == "speed_m_s":
            values[parameter.name] = float(rng.uniform(0.15, 0.6))
    return {"effect": effect.id, "axis": axis, "parameters": values}


def places() -> list[tuple[Effect, int | None]]:
    """Every effect of the mechanics at every place."""
    return [
        (effect, axis)
        for effect in effects_of(MachineKind.WEB_LINE)
        if not effect.nuisance
        for axis in ((1, 2) if effect.per_axis else (None,))
    ]


def machine(seed: int) -> tuple[ModelParameters, float, float]:
    """Another machine than the demonstrator: the model, its top speed in m/s, and the factor on the noise."""
    rng = np.random.default_rng([11, seed])
    radius, inertia = rng.uniform(0.08, 0.25), float(np.exp(rng.uniform(np.log(0.3), np.log(2.5))))
    tension = float(rng.uniform(60.0, 200.0))
    data = {
        **DEMONSTRATOR,
        "web": {
            "youngs_modulus_Pa": float(rng.uniform(3e9, 1.2e10)),
            "width_m": float(rng.uniform(0.3, 1.2)),
            "thickness_m": float(rng.uniform(4e-5, 1.2e-4)),
            "span_length_m": float(rng.uniform(0.5, 2.0)),
        },
        "rollers": {"radius_m": float(radius), "inertia_kg_m2": 1.167 * inertia, "gear_ratio": 5.0},
        "drives": {
            **DEMONSTRATOR["drives"],
            "velocity_kp_Nm_s_per_rad": 1.5 * inertia,
            "velocity_ki_Nm_per_rad": 30.0 * inertia,
            "torque_limit_Nm": 9.0 * max(inertia, 1.0),
        },
        "boundary": {"upstream_tension_N": tension, "downstream_tension_N": 0.9 * tension},
    }
    return ModelParameters.model_validate(data), float(rng.uniform(2.0, 6.0)), float(rng.uniform(0.5, 2.0))


def cases(what: list[str], seeds: range, duration_s: float) -> list[Case]:
    """All cases asked for."""
    made = []
    for seed in seeds:
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


def run(case: Case) -> Case:
    """Make the recording, diagnose, compare."""
    model, top_m_s, noise = ModelParameters.model_validate(DEMONSTRATOR), TOP_M_S, 1.0
    if case.machine:
        model, top_m_s, noise = machine(zlib.crc32(case.name.encode()))
    effects = [EffectEntry.model_validate(item) for item in case.hidden]

    def made(factor: float) -> Recording:
        return hidden_recording(
            model,
            effects,
            duration_s=case.duration_s,
            seed=case.seed,
            unknown=case.unknown,
            noise=factor,
            top_m_s=top_m_s,
        )

    recording = made(noise)
    predictor, quiet = (FreeRun(model, measured_from(item, model, "blind")) for item in (recording, made(0.0)))
    noise2 = np.array([predictor.floor(k) ** 2 for k in range(len(predictor.names))]) + predictor.tolerances**2

    def shows(known: list[EffectEntry]) -> bool:
        """Whether what is hidden beside these raises the log likelihood by enough."""
        pack = lay.pack(model.model_copy(update={"effects": known}))
        hidden = (quiet.measured - quiet.predict(pack)[0])[:, predictor.rows]
        return bool(np.sum(np.sum(hidden**2, axis=1) / (2.0 * noise2)) > VISIBLE)

    each = [[other for other in effects if other is not one] for one in effects] or [[]]
    case.visible = case.kind == "nothing" or all(map(shows, each))
    began = time.perf_counter()
    try:
        found = diagnose(recording, model, "blind")
    except Exception as error:  # a case that fails is a row of the table, not the end of the run
        case.problem = f"{type(error).__name__}: {error}"
        return case
    case.seconds = round(time.perf_counter() - began, 2)
    case.verdict = found.verdict
    case.found = [[e.effect, e.axis] for e in found.effects]
    case.tied = [e.tied_with for e in found.effects]
    case.ratio = max(gap.after / gap.noise_floor for gap in found.gaps)
    for e in found.effects:
        match = [item for item in case.hidden if (item["effect"], item["axis"]) == (e.effect, e.axis)]
        for name, value in e.parameters.items():
            if match and name in match[0]["parameters"]:
                case.covered.append(holds(value, match[0]["parameters"][name]))
    return case


def holds(value: Value, true: float) -> bool:
    """Whether the interval of a parameter has its true value in it; of an angle, that value some turns on."""
    low, high = value.ci95
    turns = round((value.value - true) / (2.0 * np.pi)) if value.unit == "rad" else 0
    return low <= true + 2.0 * np.pi * turns <= high


def right(case: Case) -> bool:
    """Whether what was named is what was hidden, or is said to be tied with it."""
    if case.kind == "unknown":
        return case.verdict == "unknown"
    hidden = [(item["effect"], item["axis"]) for item in case.hidden]
    if len(hidden) != len(case.found) or case.verdict != ("named" if hidden else "complete"):
        return False
    options = [
        {(effect, axis), *(named(name, axis) for name in tied)}
        for (effect, axis), tied in zip(case.found, case.tied, strict=True)
    ]
    return any(all(h in o for h, o in zip(order, options, strict=True)) for order in permutations(hidden))


def named(tied: str, axis: int | None) -> tuple[str, int | None]:
    """Effect and axis of a tied effect as it is printed; without an axis it is the one of what it is tied with."""
    if tied in {effect.lookalike.name for effect in effects_of(MachineKind.WEB_LINE) if effect.lookalike is not None}:
        return tied, None
    effect, _, other = tied.partition(" (axis ")
    if other:
        return effect, int(other.rstrip(")"))
    return effect, axis if find_effect(effect).per_axis else None


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
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--what", default="single,pair,nothing,unknown")
    parser.add_argument("--duration", type=float, default=66.0, help="length of each recording, s")
    parser.add_argument("--machines", action="store_true", help="another machine for each case")
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    parser.add_argument("--docs", type=Path, help="page that gets the table")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    asked = cases(options.what.split(","), seeds, options.duration)
    for case in asked:
        case.duration_s, case.machine = options.duration, options.machines
    done = finished_cases.finish(asked, run, options.cases)
    table = summary(sorted(done, key=lambda case: case.name))
    print(table)
    if options.docs is not None:
        docs_page.put(options.docs, "scoreboard", table)


if __name__ == "__main__":
    main()
