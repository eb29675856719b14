"""How often the diagnosis of a line of several spans is right, and at the right place, on equations not its own.

    diagnose_lines.py [--what single,nothing] [--seeds N] [--first-seed N] [--jobs N] [--cases FILE] [--write]

The machine is the independent line of several spans of the tests: pieces of web that wander from span to span,
presliding friction, quantized encoders. A seed draws a line of three spans, and hides in it each effect once, at
an axis or a span that is drawn, in a size from half the usual one to twice that; `nothing` hides nothing, five
times a seed. Loops are the model's in a third of the cases, else off by up to 30 %, with lags of 0 to 4 ms; rows
come every 1 to 20 ms, with jitter; commands or speeds may be missing. Prints shares by effect, the coverage of the
intervals, and what was wrong; counted by itself is where nothing is named and the diagnosis says that these data can't
show the effect at its place in its size. `--cases` keeps each finished case in a line of that file and takes those that
are there as done; `--write` writes it into docs/tables and the page.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import docs_page
import finished_cases
import numpy as np
from drawn_effects import SINGLES, drawn_values

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # the line lies with the tests

from tests.independent_line import effect  # noqa: E402
from tests.independent_line.spans import LineOfSpans, at_span, of_drives  # noqa: E402

from hilbench.diagnosis.diagnosis import diagnose  # noqa: E402
from hilbench.errors import UnusableInputError  # noqa: E402
from hilbench.plant.effects import find_effect  # noqa: E402
from hilbench.plant.web_line.parameters import ModelParameters  # noqa: E402
from hilbench.results.recording import Recording  # noqa: E402

SPANS = 3
DURATION_S = 40.0
#: What is hidden, one of each: sizes that are usual on this machine.
HIDDEN = {**SINGLES, "splice": {"time_s": 0.0, "relative_change": 0.3, "length_m": 0.4}}


@dataclass
class Case:
    """What is hidden and how it was recorded, and what was found."""

    kind: str
    seed: int
    hidden: list[dict[str, Any]]
    line: dict[str, Any]
    verdict: str = ""
    found: list[list[Any]] = field(default_factory=list)  #: effect, axis, span, and what is tied with it
    covered: list[bool] = field(default_factory=list)
    hardly: list[list[Any]] = field(default_factory=list)  #: effect, axis, span, size, order
    predicted_on: str = ""
    problem: str = ""
    seconds: float = 0.0

    @property
    def name(self) -> str:
        """What tells it from others."""
        return json.dumps([self.kind, self.seed, self.hidden, self.line])


def conditions(rng: np.random.Generator) -> dict[str, Any]:
    """A line, and how it is recorded."""
    rollers = SPANS + 1
    axes = range(1, rollers + 1)
    lost = [[], [], [f"v{axis}_cmd_m_s" for axis in axes], [f"v{axis}_m_s" for axis in axes]]
    loops = {"kp": [1.0] * rollers, "ki": [1.0] * rollers, "lag_s": [0.001] * rollers}
    if rng.random() > 1.0 / 3.0:
        loops = {
            "kp": list(map(float, rng.uniform(0.7, 1.3, rollers))),
            "ki": list(map(float, rng.uniform(0.7, 1.3, rollers))),
            "lag_s": list(map(float, rng.uniform(0.0, 0.004, rollers))),
        }
    return {
        "lengths_m": [round(float(length), 2) for length in rng.uniform(0.8, 3.0, SPANS)],
        "loops": loops,
        "row_s": float(rng.choice([0.001, 0.002, 0.002, 0.004, 0.01, 0.02])),
        "jitter_s": float(rng.choice([0.0, 0.0, 2e-5])),
        "without": lost[int(rng.integers(len(lost)))],
        "bristle_N_per_m": float(rng.uniform(5e4, 5e5)),
    }


def hidden(name: str, rng: np.random.Generator) -> dict[str, Any]:
    """An effect of a drawn size at a drawn place."""
    values = drawn_values(HIDDEN[name], rng, DURATION_S)
    row = find_effect(name)
    axis = int(rng.integers(1, SPANS + 2)) if row.per_axis else None
    return dict(at_span(effect(name, axis, **values), int(rng.integers(1, SPANS + 1)) if row.per_section else None))


def asked_for(what: Iterable[str], seeds: range) -> list[Case]:
    """All cases."""
    made: list[Case] = []
    for seed in seeds:
        rng = np.random.default_rng([31, seed])
        singles = [Case("single", seed, [hidden(name, rng)], conditions(rng)) for name in HIDDEN]
        made += singles if "single" in what else []
        nothing = [Case("nothing", 100 * seed + k, [], conditions(rng)) for k in range(5)]
        made += nothing if "nothing" in what else []
    return made


def run(case: Case) -> Case:
    """Record, diagnose, compare."""
    loops = of_drives(**{name: tuple(values) for name, values in case.line["loops"].items()})
    machine = LineOfSpans(hidden=case.hidden, **{**case.line, "loops": loops})
    recording = Recording(machine.record("identification", case.seed, DURATION_S).channels)
    began = time.process_time()
    try:
        found = diagnose(recording, ModelParameters.model_validate(machine.model), "stand")
    except UnusableInputError as error:
        case.problem = str(error)
        return case
    case.seconds = round(time.process_time() - began, 2)
    case.verdict, case.predicted_on = found.verdict, found.predicted_on
    case.hardly = [[u.effect, u.axis, u.section, u.smallest_visible, u.order] for u in found.unobservable]
    case.found = [[e.effect, e.axis, e.section, e.tied_with] for e in found.effects]
    for e in found.effects:
        for item in case.hidden:
            if (item["effect"], item["axis"], item["span"]) != (e.effect, e.axis, e.section):
                continue
            for name, value in e.parameters.items():
                if value.ci95[0] < value.ci95[1]:
                    case.covered.append(value.ci95[0] <= item["parameters"][name] <= value.ci95[1])
    return case


def is_right(case: Case) -> bool:
    """Whether what is hidden, and nothing else, was named at its place, or is said to be tied with what was."""
    if len(case.found) != len(case.hidden) or case.verdict != ("named" if case.hidden else "complete"):
        return False
    return all(
        any((item["effect"], item["axis"], item["span"]) in _options(found) for found in case.found)
        for item in case.hidden
    )


def _options(found: list[Any]) -> set[tuple[str, int | None, int | None]]:
    """What was named, and what is tied with it."""
    name, axis, span, tied = found
    options = {(name, axis, span)}
    for text in tied:
        match = re.fullmatch(r"(\w+)(?: \((axis|span) (\d+)\))?", text)
        if match is None:  # no effect of the vocabulary
            continue
        row, number = find_effect(match[1]), int(match[3]) if match[3] else None
        here = (number or axis, None) if row.per_axis else (None, number or (span if row.per_section else None))
        options.add((row.id, *here))
    return options


def is_said_to_be_hidden(case: Case) -> bool:
    """Whether nothing is named, and what is hidden is among what these data could hardly show in its size."""
    return case.verdict == "complete" and all(any(_below(item, row) for row in case.hardly) for item in case.hidden)


def _below(item: dict[str, Any], row: list[Any]) -> bool:
    """Whether an effect is smaller than the smallest of its kind that shows there, and of an order that does not."""
    name, axis, span, smallest, order = row
    if (item["effect"], item["axis"], item["span"]) != (name, axis, span):
        return False
    size = abs(item["parameters"][find_effect(name).strength[0]])
    return (smallest is None or size < smallest) and (order is None or item["parameters"]["order"] >= order)


def has_false_name(case: Case) -> bool:
    """Whether something is named that is neither hidden nor tied with what is."""
    places = {(item["effect"], item["axis"], item["span"]) for item in case.hidden}
    return any(not _options(found) & places for found in case.found)


def rows(done: list[Case]) -> list[list[str]]:
    """Counts by effect."""
    groups = [(name, [c for c in done if c.hidden and c.hidden[0]["effect"] == name]) for name in HIDDEN]
    groups.append(("nothing", [c for c in done if not c.hidden]))
    found = []
    for name, mine in groups:
        if mine:
            false = sum(map(has_false_name, mine))
            unseen = sum(map(is_said_to_be_hidden, (case for case in mine if case.hidden)))
            found.append([name, *map(str, (len(mine), sum(map(is_right, mine)), unseen, false))])
    return found


TABLE = docs_page.Table(
    "diagnosis_lines",
    "diagnosis_method.md",
    ("hidden", "cases", "right", "said not to show", "false names"),
    lambda rows: docs_page.gathered(rows, lambda row: row["cases"] == row["right"] and row["false names"] == "0"),
)


def text(done: list[Case]) -> str:
    """Coverage, and what was wrong."""
    lines: list[str] = []
    covered = [each for case in done if is_right(case) for each in case.covered]
    if covered:
        lines += [f"95 % intervals hold the true value in {100.0 * np.mean(covered):.1f} % of {len(covered)}"]
    if done:
        lines.append(f"CPU time of a diagnosis, median: {np.median([case.seconds for case in done]):.0f} s")
    for case in done:
        if not is_right(case) and not is_said_to_be_hidden(case):
            what = [(i["effect"], i["axis"] or i["span"], *i["parameters"].values()) for i in case.hidden]
            rows = f"rows {1e3 * case.line['row_s']:g} ms"
            lines += ["", f"{what} ({rows}) → {case.verdict} {case.found} {case.problem}"]
    return "\n".join(lines)


def main() -> None:
    """Run on some cores and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--what", default="single,nothing")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int)
    parser.add_argument("--cases", type=Path, help="file of finished cases, a line each")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    done = finished_cases.finish(asked_for(options.what.split(","), seeds), run, options.cases, options.jobs)
    done.sort(key=lambda case: case.name)
    print(docs_page.markdown(TABLE.columns, rows(done)), text(done), sep="\n\n")
    if options.write:
        TABLE.write(rows(done))
        docs_page.put(docs_page.DOCS / TABLE.page, "lines", text(done))


if __name__ == "__main__":
    main()
