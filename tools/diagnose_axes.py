"""How often the diagnosis is right on rotary axes of all sizes that share no equation with it.

    diagnose_axes.py [--seeds N] [--first-seed N] [--jobs N] [--cases FILE] [--write]

The machine is `tests/independent_axis`: 50 W motors to flywheels of 23 kg·m², trapezoids, sines, moves between two
places, one direction; encoders of 4,096 to 2^20 counts; rows of 1 and 4 ms. Each seed draws a machine and what is
hidden in it: one effect, two, nothing, or what the vocabulary of an axis does not have (gear play, a friction that
warms up). The model knows inertia, dry and viscous friction. Prints shares by size, the coverage of the intervals, and
what was wrong. `--cases` keeps each finished case in a line of that file and takes those that are there as done;
`--write` writes it into docs/tables and the page.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any

import docs_page
import finished_cases
import numpy as np
from diagnose_scoreboard import Case, holds

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the axis lies with the tests

from tests.independent_axis import MOTIONS, SIZES, Axis  # noqa: E402

from hilbench.diagnosis.diagnosis import diagnose  # noqa: E402
from hilbench.errors import UnusableInputError  # noqa: E402
from hilbench.plant.servo_axis.parameters import ServoAxisParameters  # noqa: E402

EFFECTS = (
    *("coulomb_friction", "viscous_friction", "friction_asymmetry", "torque_ripple"),
    *("torque_offset", "torque_scale", "inertia_mismatch", "unbalance"),
)
#: Two that are one where friction is small beside the inertia.
_ALIKE = {"torque_scale", "inertia_mismatch"}
#: Share of the rated torque that an effect adds, its rms.
LEAST, MOST = 0.01, 0.04
KINDS = ("single", "single", "single", "single", "single", "single", "pair", "nothing", "unknown")


@dataclass
class Recorded(Case):
    """A case with the axis that it was recorded on."""

    size: str = ""
    axis: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What tells it from others."""
        return json.dumps([self.kind, self.seed, self.hidden, self.size, self.axis])


def parameters(effect: str, axis: Axis, seed: int, rng: np.random.Generator) -> dict[str, float] | None:
    """Parameters with which an effect adds a drawn share of the rated torque; None where this motion can't show it."""
    added_Nm = float(rng.uniform(LEAST, MOST)) * axis.rated_Nm
    t_s, command = axis.command(seed)
    speed, rate = float(np.sqrt(np.mean(command**2))), float(np.std(np.gradient(command, t_s)))
    sign, phase = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-3.0, 3.0))
    relative = sign * added_Nm / (axis.inertia_kg_m2 * rate)
    turns = float(np.ptp(np.cumsum(command)) * t_s[1]) / (2.0 * np.pi)
    made: dict[str, tuple[dict[str, float], bool]] = {
        "coulomb_friction": ({"torque_Nm": added_Nm}, True),
        "viscous_friction": ({"coefficient_Nm_s_per_rad": added_Nm / speed}, True),
        "friction_asymmetry": (
            {"viscous_difference_Nm_s_per_rad": sign * min(added_Nm / speed, axis.viscous_Nm_s)},
            axis.motion != "one direction" and axis.viscous_Nm_s * speed > LEAST * axis.rated_Nm,
        ),
        "torque_ripple": (
            {"amplitude_Nm": 1.4 * added_Nm, "order": float(rng.integers(2, 25)), "phase_rad": phase},
            turns > 0.5,
        ),
        "torque_offset": ({"offset_Nm": sign * added_Nm}, True),
        "torque_scale": ({"relative_change": relative}, abs(relative) < 0.25),
        "inertia_mismatch": ({"relative_change": relative}, abs(relative) < 0.25),
        "unbalance": ({"amplitude_Nm": 1.4 * added_Nm, "phase_rad": phase}, turns > 1.0),
    }
    values, shows = made[effect]
    return values if shows else None


def drawn(seed: int) -> Recorded:
    """One axis, and what is hidden in it."""
    rng = np.random.default_rng([31, seed])
    size, motion = str(rng.choice(list(SIZES))), str(rng.choice(MOTIONS))
    axis, kind = Axis.drawn(size, motion, rng), str(rng.choice(KINDS))
    hidden: dict[str, dict[str, float]] = {}
    for effect in rng.permutation(EFFECTS).tolist():
        if len(hidden) == {"single": 1, "pair": 2}.get(kind, 0):
            break
        values = parameters(effect, axis, seed, rng)
        if values is not None and not {effect, *hidden} >= _ALIKE:
            hidden[effect] = values
    figures = {name: value for name, value in vars(axis).items() if name != "hidden"}
    if kind == "unknown":
        figures |= {"play_rad": float(rng.uniform(0.01, 0.05))} if rng.random() < 0.5 else {"warming": 0.5}
    of = [{"effect": effect, "axis": 1, "parameters": values} for effect, values in hidden.items()]
    return Recorded(kind, seed, of, size=size, axis=figures)


def run(case: Recorded) -> Recorded:
    """Record, diagnose, compare."""
    axis = Axis(**case.axis, hidden={item["effect"]: item["parameters"] for item in case.hidden})
    recording, model = axis.recording(case.seed), ServoAxisParameters.model_validate(axis.model)
    began = time.process_time()
    try:
        found = diagnose(recording, model, "stand")
    except UnusableInputError as error:
        case.problem = str(error)
        return case
    case.seconds = round(time.process_time() - began, 2)
    case.verdict, case.found = found.verdict, [[e.effect, e.axis] for e in found.effects]
    case.tied = [e.tied_with for e in found.effects]
    case.ratio = max(gap.after / gap.noise_floor for gap in found.gaps)
    named = {e.effect for e in found.effects}
    for e in found.effects if named == {item["effect"] for item in case.hidden} else []:
        match = [item["parameters"] for item in case.hidden if item["effect"] == e.effect]
        for name, value in e.parameters.items():
            if match and name in match[0] and name not in ("phase_rad", "order"):
                case.covered.append(holds(value, match[0][name]))
    return case


def right(case: Recorded) -> bool:
    """Whether what was named is what was hidden, or is tied with it."""
    if case.kind == "unknown":
        return case.verdict == "unknown"
    hidden, options = [item["effect"] for item in case.hidden], _options(case)
    if len(hidden) != len(options) or case.verdict != ("named" if hidden else "complete"):
        return False
    return any(all(h in o for h, o in zip(order, options, strict=True)) for order in permutations(hidden))


def _options(case: Recorded) -> list[set[str]]:
    return [
        {name, *(each.partition(" (")[0] for each in of)} for (name, _), of in zip(case.found, case.tied, strict=True)
    ]


def false_names(case: Recorded) -> int:
    """Effects that are named and neither hidden nor tied with what is."""
    if right(case):
        return 0
    hidden = {item["effect"] for item in case.hidden}
    return sum(not each & hidden for each in _options(case))


def rows(done: list[Recorded]) -> list[list[str]]:
    """Counts by size and kind."""
    of = {size: [case for case in done if case.size == size and case.kind != "unknown"] for size in SIZES}
    of["what no effect explains"] = [case for case in done if case.kind == "unknown"]
    return [[name, str(len(mine)), *map(str, _counts(mine))] for name, mine in of.items() if mine]


def _counts(mine: list[Recorded]) -> tuple[int, int]:
    return sum(map(right, mine)), sum(false_names(case) > 0 for case in mine)


def _in_all(rows: Sequence[docs_page.Row]) -> str:
    """Sums of the counts in the table."""
    cases, found, false = (sum(int(row[name]) for row in rows) for name in ("cases", "right", "with a false name"))
    return f"{found} of {cases} right, {false} with a false name."


TABLE = docs_page.Table(
    "diagnosis_axes",
    "diagnosis_method.md",
    ("axes", "cases", "right", "with a false name"),
    _in_all,
)


def text(done: list[Recorded]) -> str:
    """Coverage and time."""
    covered = [each for case in done if right(case) for each in case.covered]
    seconds = sorted(case.seconds for case in done)
    share = f"{100.0 * np.mean(covered):.1f} % of {len(covered)}" if covered else "–"
    return (
        f"95 % intervals of what was named right hold the true value in {share}\n"
        f"CPU time of a diagnosis: median {np.median(seconds):.1f} s, largest {seconds[-1]:.0f} s"
    )


def wrong(done: list[Recorded]) -> str:
    """What was wrong."""
    lines = []
    for case in sorted(done, key=lambda case: case.seed):
        if not right(case):
            a = case.axis
            hidden = [
                (i["effect"], *(float(f"{value:.3g}") for value in i["parameters"].values())) for i in case.hidden
            ]
            extra = {name: a[name] for name in ("play_rad", "warming") if a.get(name)}
            how = f"{case.size}, {a['motion']}, {a['counts_per_turn']} counts, rows {1e3 * a['row_s']:g} ms"
            lines.append(f"{case.seed}: {how}: {hidden or extra} → {case.verdict} {case.found} {case.problem}")
    return "\n".join(lines)


def main() -> None:
    """Run on all cores and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=96)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    asked = [drawn(seed) for seed in range(options.first_seed, options.first_seed + options.seeds)]
    done = finished_cases.finish(asked, run, options.cases, options.jobs)
    print(docs_page.markdown(TABLE.columns, rows(done)), text(done), wrong(done), sep="\n\n")
    if options.write:
        TABLE.write(rows(done))
        docs_page.put(docs_page.DOCS / TABLE.page, "axes", text(done))


if __name__ == "__main__":
    main()
