"""Does the twin hold for a shift? The scoreboard: benches in process, and an estimator alone on the independent line.

    shift.py                                    all cases: hours of the machine
    shift.py --list                             their names
    shift.py --part offline --only "stops / steps / creep"    cases whose names have that in them
    shift.py --method all                       every synchronizer (offline, and the bench of one span)
    shift.py --jobs 2 --results shift.jsonl     keeps what is finished: an ended tool goes on there
    shift.py --results shift.jsonl --table      the tables of what is kept, nothing is run
    shift.py --write                            writes docs/tables/shift_*.csv and docs/compare_methods.md
    shift.py --part bench --hours 8 --only winding_line --picture    draws it into docs/images

Offline: a quarter of an hour of `tests/independent_line`, whose tension is kept by its own sensor, so that nothing but
the estimate is judged; what is hidden there the twin's model lacks. Half widths of the 95 % interval are beside those
of the best estimators (`tests/estimation/best_estimator.py`): one that knows which effects are hidden, and one that
allows for whatever may be. Bench: the shipped machines with a right model, round and round through all that happens in
a shift (`tests/estimation/shift_bench.py`), or in a hold alone; a tension is judged by its set-point. Everywhere E
counts in motion, 1 s behind each of its steps left out.
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
import numpy as np
from tests.estimation import shift_bench, shift_offline
from tests.independent_line.shift import SHIFT_S

from hilbench.results.web_line_synchronization import methods_of

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"


@dataclass(frozen=True)
class Case:
    """A case of either part with one method, and what came of it."""

    part: str
    case: str
    method: str
    figures: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Unique among the cases."""
        return f"{self.part}: {self.case}, {self.method}"


def offline_cases(methods: Sequence[str]) -> list[Case]:
    """Of the independent line."""
    return [Case("offline", case.name, method) for case in shift_offline.CASES for method in methods]


def bench_cases(methods: Sequence[str]) -> list[Case]:
    """Of the shipped machines; the line of one span with each method."""
    found = []
    for title, machine in shift_bench.MACHINES.items():
        several = machine.name == "web_section_step"
        found += [Case("bench", title, method) for method in (methods if several else methods[:1])]
    return found


def run(case: Case, minutes: float, hours: float, picture: bool) -> Case:
    """One case."""
    done = _run_bench(case, hours, picture) if case.part == "bench" else _run_offline(case, 60.0 * minutes)
    print(f"{done.name}: {done.figures}", file=sys.stderr, flush=True)
    return done


def _run_bench(case: Case, hours: float, picture: bool) -> Case:
    shift = shift_bench.Shift(shift_bench.MACHINES[case.case], hours, case.method, draws=picture)
    outcome = shift.run()
    if picture:
        draw(shift, IMAGES / f"shift_{case.case.replace(', ', '_').replace(' ', '_')}.png")
    return Case(case.part, case.case, case.method, outcome.figures)


def _run_offline(case: Case, duration_s: float) -> Case:
    (shift,) = (each for each in shift_offline.CASES if each.name == case.case)
    (outcome,) = shift_offline.outcomes(shift, methods_of(case.method), duration_s=duration_s)
    return Case(case.part, case.case, case.method, outcome.figures)


# -- picture -----------------------------------------------------------------------------------------------------------


def draw(shift: shift_bench.Shift, path: Path) -> None:
    """Tensions with their set-points, estimates with their intervals, over the hours: what lies between the least and
    the largest value of each column of the picture."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    found, scored = shift.scored.pictures, shift.scored
    names = [*scored.tensions, *scored.estimates]
    figure, axes = pyplot.subplots(len(names), sharex=True, figsize=(11.0, 2.4 * len(names)), squeeze=False)
    hours = np.arange(shift_bench.COLUMNS) * shift.until_s / shift_bench.COLUMNS / 3600.0
    for axis, name in zip(axes[:, 0], names, strict=True):
        if name in scored.tensions:
            _band(axis, hours, found[f"{name}_true_N"], "C0", "true tension")
            _band(axis, hours, found[f"{name}_ref_N"], "C1", "set-point")
            axis.set_ylabel(f"{name} in N")
        else:
            low, high = found[f"{name}_low"].low, found[f"{name}_high"].high
            axis.fill_between(hours, low, high, color="C0", alpha=0.2, lw=0.0, label="95 % interval")
            _band(axis, hours, found[f"{name}_sim"], "C0", "estimate")
            _band(axis, hours, found[f"{name}_true"], "C1", "true")
            true = found[f"{name}_true"]
            seen = np.isfinite(true.low)
            axis.set_ylim(0.5 * float(true.low[seen].min()), 1.5 * float(true.high[seen].max()))
            axis.set_ylabel(name)
        axis.legend(loc="upper right", ncols=3, fontsize="small")
    axes[-1, 0].set_xlabel("time in h")
    figure.suptitle(f"{shift.machine.title}, {shift.method}")
    figure.tight_layout()
    figure.savefig(path, dpi=100)
    pyplot.close(figure)


def _band(axis: Any, hours: Any, envelope: shift_bench.Envelope, colour: str, label: str) -> None:
    axis.fill_between(hours, envelope.low, envelope.high, color=colour, lw=0.8, label=label)


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
BENCH: Columns = {
    "h": lambda f: f"{f['simulated_s'] / 3600.0:.2g}",
    "worst in %": lambda f: _number(f["worst_pct"]),
    "within 1 % in %": lambda f: f"{f['within_pct']:.1f}",
    "95 % holds in %": lambda f: f"{f['held_pct']:.1f}",
    "half width in %": lambda f: _number(f["half_pct"]),
    "tension, worst in N": lambda f: _number(f["tension_N"]),
    "within 1 N in %": lambda f: f"{f['tension_within_pct']:.1f}",
    "alarms": lambda f: str(f["alarms"]),
    "loop opened": lambda f: str(f["opened"]),
    "µs": lambda f: f"{f['cpu_us']:.1f}",
    "ended by": lambda f: f["ended"] or "–",
}
COLUMNS = {"bench": BENCH, "offline": OFFLINE}


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.3g}".replace("-", "−")


def rows(part: str, cases: Sequence[Case]) -> list[list[str]]:
    """Of the table of one part."""
    return [[case.case, case.method, *(show(case.figures) for show in COLUMNS[part].values())] for case in cases]


def summary(*titles: str, least_pct: float = 0.0) -> Callable[[list[docs_page.Row]], str]:
    """These columns of rows that are so far off, the method where there are several; how often the interval holds."""

    def made(rows: list[docs_page.Row]) -> str:
        several = ["method"] if len({row["method"] for row in rows}) > 1 else []
        columns = ["shift", *several, *titles]
        held = min((row["95 % holds in %"] for row in rows), key=float)
        off = [row for row in rows if abs(float(row["worst in %"].replace("−", "-"))) >= least_pct]
        table = docs_page.markdown(columns, [[row[title] for title in columns] for row in off])
        return f"The 95 % interval holds in at least {held} % of the cycles.\n\n{table}"

    return made


TABLES = {
    "bench": docs_page.Table(
        "shift_bench",
        "compare_methods.md",
        ("shift", "method", *BENCH),
        summary("h", "worst in %", "tension, worst in N"),
    ),
    "offline": docs_page.Table(
        "shift_offline",
        "compare_methods.md",
        ("shift", "method", *OFFLINE),
        summary("worst in %", "half width in %", "best possible in %", least_pct=1.0),
    ),
}


def by_part(cases: Sequence[Case]) -> dict[str, list[list[str]]]:
    """Rows of the parts that have cases."""
    return {part: rows(part, of) for part in COLUMNS if (of := [case for case in cases if case.part == part])}


# -- command line ------------------------------------------------------------------------------------------------------


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=list(COLUMNS), help="both where it is not given")
    parser.add_argument("--only", default="", metavar="TEXT", help="cases with this in their names")
    parser.add_argument("--method", default="changepoint", help="some, comma-separated, or all")
    parser.add_argument("--minutes", type=float, default=SHIFT_S / 60.0, help="length of a shift offline")
    parser.add_argument("--hours", type=float, default=8.0, help="process time of a bench; of shift.yaml its own")
    parser.add_argument("--picture", action="store_true", help=f"draw benches into {IMAGES.relative_to(ROOT)}")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--results", type=Path, metavar="FILE", help="JSON, a line a case")
    parser.add_argument("--list", action="store_true", help="print the cases' names alone")
    parser.add_argument("--table", action="store_true", help="run nothing: tables of what is in --results")
    parser.add_argument("--write", action="store_true", help="write shift_*.csv and docs/compare_methods.md")
    options = parser.parse_args()
    methods = list(methods_of(options.method))
    asked = [case for case in (*bench_cases(methods), *offline_cases(methods)) if options.only in case.name]
    asked = [case for case in asked if options.part in (None, case.part)]
    if options.list:
        print("\n".join(case.name for case in asked))
        return
    if options.table:
        done = finished_cases.kept_of(asked, options.results)
    else:
        act = partial(run, minutes=options.minutes, hours=options.hours, picture=options.picture)
        done = finished_cases.finish(asked, act, options.results, options.jobs)
    order = {case.name: number for number, case in enumerate(asked)}
    for part, found in by_part(sorted(done, key=lambda case: order[case.name])).items():
        print(f"{part}\n\n{docs_page.markdown(TABLES[part].columns, found)}\n")
        if options.write:
            TABLES[part].write(found)


if __name__ == "__main__":
    main()
