"""How often the diagnosis is right on recordings that share no equation with it, made as stands make them.

    diagnose_independent.py [--what conditions,drawn,intervals] [--seeds N] [--first-seed N] [--interval-seeds N]
                            [--jobs N] [--cases FILE] [--write]
    diagnose_independent.py --what noises [--seeds N] [--first-seed N] [--jobs N] [--cases FILE]

The machine is the independent line of the tests: web in pieces that move with it, presliding friction, quantized
encoders. `conditions` hides seven effects, one at a time, under each of some conditions that a model does not know:
other gains of the drives, a slower current loop, no commands, coarse rows, speeds for positions, a torque that is
missing, a production run. `drawn` draws loops ±30 %, lags of 0 to 4 ms, rows of 1 to 20 ms, jitter, missing channels
and profiles, all at once, for single effects, pairs, nothing, and what the vocabulary does not have. `intervals` takes
the names of drawn singles and pairs for known and looks at their intervals alone. `noises` records those of them again
of which an interval did not hold, each with other noises: whether it was chance. Prints shares, the coverage of the
intervals, and what was wrong. `--cases` keeps each finished case in a line of that file and takes those that are there
as done; `--write` writes it into docs/tables and the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import docs_page
import finished_cases
import numpy as np
from diagnose_scoreboard import Case, holds, right
from drawn_effects import SINGLES, drawn_values

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the line lies with the tests

from tests.independent_line import Line, Loops, effect  # noqa: E402

from hilbench.diagnosis.diagnosis import Diagnosis, Explained, concluded, diagnose  # noqa: E402
from hilbench.diagnosis.fit import fit  # noqa: E402
from hilbench.diagnosis.measured import measured_from  # noqa: E402
from hilbench.diagnosis.predictor import choice  # noqa: E402
from hilbench.diagnosis.proposals import Proposer  # noqa: E402
from hilbench.diagnosis.selection import CandidateSet, Selection  # noqa: E402
from hilbench.diagnosis.space import Space, noise_model  # noqa: E402
from hilbench.errors import UnusableInputError  # noqa: E402
from hilbench.plant.effects import find_effect  # noqa: E402
from hilbench.plant.web_line.parameters import ModelParameters  # noqa: E402
from hilbench.results.recording import Recording  # noqa: E402

COMMANDS = ["v1_cmd_m_s", "v2_cmd_m_s"]
#: One of each family.
SEVEN: tuple[Any, ...] = (
    effect("torque_offset", 2, offset_Nm=0.04),
    effect("coulomb_friction", 2, force_N=4.2),
    effect("viscous_friction", 1, coefficient_N_s_per_m=2.0),
    effect("roller_eccentricity", 2, amplitude_m=2.5e-5, phase_rad=0.3),
    effect("inertia_mismatch", 2, relative_change=0.15),
    effect("elasticity_shift", relative_change=0.15),
    effect("web_slip", creep_per_N=2.2e-6),
)
#: Keyword arguments of the line, and the profile.
CONDITIONS: dict[str, dict[str, Any]] = {
    "as the model": {},
    "gains +20 %, −15 %": {"loops": {"kp": (1.2, 1.2), "ki": (0.85, 0.85)}},
    "current loop 3 ms": {"loops": {"lag_s": (0.003, 0.003)}},
    "no commands": {"without": COMMANDS},
    "rows every 10 ms": {"row_s": 0.01},
    "rows every 20 ms": {"row_s": 0.02},
    "speeds, no positions": {"without": ["x1_m", "x2_m"]},
    "no torque of axis 1": {"without": ["tau1_Nm"]},
    "production run": {"profile": "production"},
}
OF_THE_WEB = ("elasticity_shift", "elasticity_step", "elasticity_drift", "web_slip", "upstream_disturbance")
UNKNOWN: tuple[Any, ...] = (
    effect("hysteresis", 2, force_N=8.0),
    effect("passing_splices", every_m=11.0, length_m=0.4, relative_change=0.5),
)
DURATION_S = 40.0
#: Conditions of cases whose names are taken for known.
_KNOWN = {
    "known": "of what is known to be hidden",
    "noises": "of what is known to be hidden where one missed, recorded anew with other noises,",
}
#: Seeds of the other noises with which a case is recorded again.
NOISES = range(1000, 1024)


@dataclass
class Recorded(Case):
    """A case with how it was recorded."""

    condition: str = ""
    line: dict[str, Any] = field(default_factory=dict)
    predicted_on: str = ""

    @property
    def name(self) -> str:
        """What tells it from others."""
        return json.dumps([self.condition, self.kind, self.seed, self.hidden, self.line])


def drawn(seed: int) -> list[Recorded]:
    """One of each kind under conditions of their own, and four singles."""
    rng = np.random.default_rng([23, seed])

    def item(names: list[str]) -> dict[str, Any]:
        name = names.pop(int(rng.integers(len(names))))
        values = drawn_values(SINGLES[name], rng, DURATION_S)
        return dict(effect(name, None if name in OF_THE_WEB else int(rng.integers(1, 3)), **values))

    def conditions() -> dict[str, Any]:
        lost: list[list[str]] = [[], [], COMMANDS, ["v1_m_s", "v2_m_s"], ["x1_m", "x2_m"], ["tau1_Nm"]]
        return {
            "profile": str(rng.choice(["identification", "identification", "production"])),
            "loops": {
                "kp": [float(k) for k in rng.uniform(0.7, 1.3, 2)],
                "ki": [float(k) for k in rng.uniform(0.7, 1.3, 2)],
                "lag_s": [float(k) for k in rng.uniform(0.0, 0.004, 2)],
                "trapezoidal": bool(rng.random() < 0.5),
            },
            "row_s": float(rng.choice([0.001, 0.002, 0.002, 0.004, 0.01, 0.02])),
            "jitter_s": float(rng.choice([0.0, 0.0, 2e-5])),
            "without": lost[int(rng.integers(len(lost)))],
            "bristle_N_per_m": float(rng.uniform(5e4, 5e5)),
        }

    made = [Recorded("single", seed, [item(list(SINGLES))], line=conditions()) for _ in range(4)]
    both = list(SINGLES)
    made.append(Recorded("pair", seed, [item(both), item(both)], line=conditions()))
    made += [Recorded("nothing", 100 * seed + k, [], line=conditions()) for k in range(2)]
    strange = UNKNOWN[seed % len(UNKNOWN)]
    made.append(Recorded("unknown", seed, [dict(strange)], line={**conditions(), "profile": "identification"}))
    for case in made:
        case.condition = "drawn"
    return made


def under_conditions(seed: int) -> list[Recorded]:
    """The seven under each condition."""
    return [
        Recorded("single", seed, [dict(item)], condition=name, line=line)
        for name, line in CONDITIONS.items()
        for item in SEVEN
    ]


def with_known_names(seed: int) -> list[Recorded]:
    """The singles and pairs that `drawn` has, of what can be seen."""
    made = [case for case in drawn(seed) if case.kind in ("single", "pair") and is_visible(case)]
    return [replace(case, condition="known") for case in made]


def with_other_noises(case: Recorded) -> list[Recorded]:
    """What was hidden and recorded the same, with known names."""
    return [Recorded(case.kind, seed, case.hidden, condition="noises", line=case.line) for seed in NOISES]


def recorded(case: Recorded) -> tuple[Recording, ModelParameters]:
    """What the case's line records, and what a model file knows of it."""
    line = dict(case.line)
    profile = line.pop("profile", "identification")
    if "loops" in line:
        loops: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in line["loops"].items()}
        line["loops"] = Loops(**loops)
    machine = Line(hidden=case.hidden, **line)
    recording = Recording(machine.record(profile, case.seed, DURATION_S).channels)
    return recording, ModelParameters.model_validate(machine.model)


def examined(case: Recorded) -> Diagnosis:
    """The diagnosis; of one with known names, what it concludes of these. Raises UnusableInputError."""
    recording, model = recorded(case)
    if case.condition not in _KNOWN:
        return diagnose(recording, model, "stand")
    data = measured_from(recording, model, "stand")
    chosen = choice(model, data)
    space, proposer = Space(model, chosen.predictor, data.period_s), Proposer(model, data)
    terms = [proposer.known(find_effect(item["effect"]), item["axis"], item["parameters"]) for item in case.hidden]
    residual = space.residual(terms)
    none = np.empty((0, *residual.shape))
    white = noise_model(space, residual, none)
    offered = CandidateSet(white, residual, none, [], [])
    selection = Selection(fit(space, white, terms), offered)
    return concluded(Explained(space, chosen, data, selection))


def run(case: Recorded) -> Recorded:
    """Record, diagnose, compare."""
    began = time.process_time()
    try:
        found = examined(case)
    except UnusableInputError as error:
        case.problem = str(error)
        return case
    case.seconds = round(time.process_time() - began, 2)
    case.verdict, case.predicted_on = found.verdict, found.predicted_on
    out_of_sight = {(blind.effect, blind.axis) for blind in found.unobservable}
    if case.hidden and not found.effects and all((e["effect"], e["axis"]) in out_of_sight for e in case.hidden):
        case.problem = "and said that these data could hardly show it"
    case.found = [[e.effect, e.axis] for e in found.effects]
    case.tied = [e.tied_with for e in found.effects]
    case.ratio = max(gap.after / gap.noise_floor for gap in found.gaps)
    for e in found.effects:
        match = [item for item in case.hidden if (item["effect"], item["axis"]) == (e.effect, e.axis)]
        for name, value in e.parameters.items():
            if match and name in match[0]["parameters"] and value.ci95[0] < value.ci95[1]:
                case.covered.append(holds(value, match[0]["parameters"][name]))
    return case


def is_visible(case: Recorded) -> bool:
    """Whether what is hidden acts on anything that is recorded: not at a roller without torque, nor in a strain that no
    position tells, nor a ripple that is faster than the rows while the speed is always the same."""
    if case.condition != "drawn":
        return True
    without = case.line.get("without", [])
    at_blind_axis = "tau1_Nm" in without and any(
        item["axis"] == 1 and item["effect"] != "roller_eccentricity" for item in case.hidden
    )
    too_fast = any(
        item["effect"] == "torque_ripple" and _ripple_Hz(item) > 0.5 / case.line["row_s"] for item in case.hidden
    )
    in_strain = "x1_m" in without and any(
        item["axis"] is None or item["effect"] in ("roller_eccentricity", "torque_scale") for item in case.hidden
    )
    return not (at_blind_axis or in_strain or (too_fast and case.line["profile"] == "production"))


def _ripple_Hz(item: dict[str, Any]) -> float:
    """Of a torque ripple at the speed of a production run, 3 m/s."""
    line = Line()
    return float(item["parameters"]["order"]) * 3.0 * line.gear_ratio / line.radius_m / (2.0 * np.pi)


def false_names(case: Recorded) -> int:
    """Effects that are named and neither hidden nor tied with what is."""
    if right(case) or case.kind == "unknown":
        return len(case.found) if case.kind == "unknown" else 0
    hidden = {(item["effect"], item["axis"]) for item in case.hidden}
    wrong = 0
    for (name, axis), tied in zip(case.found, case.tied, strict=True):
        options = {(name, axis)} | {(each.partition(" (axis ")[0], axis) for each in tied}
        wrong += not any(effect == other for effect, _ in hidden for other, _ in options)
    return wrong


def rows(done: list[Recorded]) -> list[list[str]]:
    """Counts by condition or kind."""
    of = {name: [case for case in done if case.condition == name] for name in CONDITIONS}
    for kind in ("single", "pair", "nothing", "unknown"):
        of[f"drawn: {kind}"] = [case for case in done if case.condition == "drawn" and case.kind == kind]
    return [[name, *map(str, _counts(mine))] for name, mine in of.items() if mine]


TABLE = docs_page.Table(
    "diagnosis_independent",
    "diagnosis_method.md",
    ("recorded", "cases", "visible", "right", "false names"),
    lambda rows: docs_page.gathered(rows, lambda row: row["visible"] == row["right"] and row["false names"] == "0"),
)


def text(done: list[Recorded]) -> str:
    """Coverage, and what was wrong."""
    lines: list[str] = []
    # Under the conditions all have the noise of one seed.
    for condition, of in {"drawn": "of what was named right", **_KNOWN}.items():
        mine = [case for case in done if case.condition == condition and (right(case) or condition in _KNOWN)]
        covered = [c for case in mine for c in case.covered]
        if covered:
            share = f"{100.0 * np.mean(covered):.1f} % of {len(covered)}"
            lines.append(f"\n95 % intervals {of} hold the true value in {share}")
    lines.append("")
    for case in (case for case in done if case.condition not in _KNOWN):
        if not right(case) and (is_visible(case) or false_names(case)):
            hidden = [
                (i["effect"], i["axis"], *(float(f"{v:.3g}") for v in i["parameters"].values())) for i in case.hidden
            ]
            without = ", ".join(case.line.get("without", []))
            how = f"{case.line.get('profile', '')} rows {1e3 * case.line.get('row_s', 0.002):g} ms"
            how += f" without {without}" if without else ""
            lines.append(f"{hidden} ({case.condition}; {how}) → {case.verdict} {case.found} {case.problem}\n")
    return "\n".join(lines).strip("\n")


def _counts(mine: list[Recorded]) -> tuple[int, int, int, int]:
    seen = [case for case in mine if is_visible(case)]
    return len(mine), len(seen), sum(map(right, seen)), sum(map(false_names, mine))


def main() -> None:
    """Run on all cores and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", default="conditions,drawn")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--interval-seeds", type=int, help="of `intervals`, by default as many as --seeds")
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    asked = under_conditions(5) if "conditions" in options.what else []
    if "drawn" in options.what:
        asked += [case for seed in seeds for case in drawn(seed)]
    if "intervals" in options.what:
        for seed in range(options.first_seed, options.first_seed + (options.interval_seeds or options.seeds)):
            asked += with_known_names(seed)
    if "noises" in options.what:
        known = [case for seed in seeds for case in with_known_names(seed)]
        for case in finished_cases.finish(known, run, options.cases, options.jobs):
            asked += [] if all(case.covered) else with_other_noises(case)
    done = finished_cases.finish(asked, run, options.cases, options.jobs)
    done.sort(key=lambda case: (case.condition, case.name))
    print(docs_page.markdown(TABLE.columns, rows(done)), text(done), sep="\n\n")
    if options.write:
        TABLE.write(rows(done))
        docs_page.put(docs_page.DOCS / TABLE.page, "independent", text(done))


if __name__ == "__main__":
    main()
