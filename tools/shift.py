"""Does the twin hold for a shift? The scoreboard: benches in process, and an estimator alone on the independent line.

    shift.py                                    all cases: hours of the machine
    shift.py --list                             their names
    shift.py --part offline --only "stops / steps / creep"    cases whose names have that in them
    shift.py --method all                       every synchronizer (offline, and the bench of one span)
    shift.py --jobs 2 --results shift.jsonl     keeps what is finished: an ended tool goes on there
    shift.py --results shift.jsonl --table      the tables of what is kept, nothing is run
    shift.py --write                            puts the tables into docs/synchronization.md

Offline: a quarter of an hour of `tests/independent_line`, whose tension is kept by its own sensor, so that nothing but
the estimate is judged; what is hidden there the twin's model lacks. Half widths of the 95 % interval are beside those
of the best estimators (`tests/estimation/best_estimator.py`): one that knows which effects are hidden, and one that
allows for whatever may be. Everywhere E counts in motion, 1 s behind each of its steps left out.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

import docs_page
import finished_cases
from tests.estimation import shift_offline
from tests.independent_line.shift import SHIFT_S

from hilbench.diagnosis.synchronization import methods_of

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "synchronization.md"


@dataclass(frozen=True)
class Case:
    """A case of either part with one method, and what came of it."""

    part: str
    case: str
    method: str
    figures: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """What tells it from others."""
        return f"{self.part}: {self.case}, {self.method}"


def offline_cases(methods: Sequence[str]) -> list[Case]:
    """Of the independent line."""
    return [Case("offline", case.name, method) for case in shift_offline.CASES for method in methods]


def run(case: Case, duration_s: float) -> Case:
    """One case."""
    (shift,) = (each for each in shift_offline.CASES if each.name == case.case)
    (outcome,) = shift_offline.outcomes(shift, methods_of(case.method), duration_s=duration_s)
    print(f"{case.name}: {outcome}", file=sys.stderr, flush=True)
    return Case(case.part, case.case, case.method, outcome.figures)


# -- tables ------------------------------------------------------------------------------------------------------------

#: Columns by their titles: how a case's figures are shown.
Columns = dict[str, Callable[[dict[str, Any]], str]]
OFFLINE: Columns = {
    "worst in %": lambda f: _number(f["worst_pct"]),
    "within 1 % in %": lambda f: f"{f['within_pct']:.1f}",
    "95 % holds in %": lambda f: f"{f['held_pct']:.1f}",
    "half width in %": lambda f: _number(f["half_pct"]),
    "best possible in %": lambda f: _number(f["best_pct"]),
    "ratio": lambda f: _number(f["half_pct"] / f["best_pct"]),
    "any effect in %": lambda f: _number(f["any_pct"]),
    "µs": lambda f: f"{f['cpu_us']:.1f}",
}
COLUMNS = {"offline": OFFLINE}


def _number(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")


def table(part: str, cases: Sequence[Case]) -> str:
    """Of one part, in Markdown."""
    columns = COLUMNS[part]
    lines = [f"| shift | method | {' | '.join(columns)} |", f"|---|---|{'--:|' * len(columns)}"]
    for case in cases:
        cells = [show(case.figures) for show in columns.values()]
        lines.append(f"| {case.case} | `{case.method}` | {' | '.join(cells)} |")
    return "\n".join(lines)


def tables(cases: Sequence[Case]) -> dict[str, str]:
    """By part, those that have cases."""
    return {part: table(part, of) for part in COLUMNS if (of := [case for case in cases if case.part == part])}


# -- command line ------------------------------------------------------------------------------------------------------


def main() -> None:
    """Run and print, or write into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=list(COLUMNS), help="both where it is not given")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their names")
    parser.add_argument("--method", default="changepoint", help="some, comma-separated, or all")
    parser.add_argument("--minutes", type=float, default=SHIFT_S / 60.0, help="length of a shift offline")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, metavar="FILE", help="JSON, a line a case")
    parser.add_argument("--list", action="store_true", help="print the cases' names alone")
    parser.add_argument("--table", action="store_true", help="run nothing: tables of what is in --results")
    parser.add_argument("--write", action="store_true", help=f"put the tables into {PAGE.relative_to(ROOT)}")
    options = parser.parse_args()
    methods = list(methods_of(options.method))
    asked = [case for case in offline_cases(methods) if options.only in case.name]
    asked = [case for case in asked if options.part in (None, case.part)]
    if options.list:
        print("\n".join(case.name for case in asked))
        return
    if options.table:
        done = finished_cases.kept_of(asked, options.results)
    else:
        done = finished_cases.finish(
            asked, partial(run, duration_s=60.0 * options.minutes), options.results, options.jobs
        )
    order = {case.name: number for number, case in enumerate(asked)}
    for part, text in tables(sorted(done, key=lambda case: order[case.name])).items():
        print(f"{part}\n\n{text}\n")
        if options.write:
            docs_page.put(PAGE, f"shift-{part}", text)


if __name__ == "__main__":
    main()
