"""What a twin makes of a step of E whose model lacks something: a table.

    hidden_beside_a_step.py [--jobs N] [--write]
    hidden_beside_a_step.py --drawn 60 [--first-seed N] [--jobs N] [--write]
    hidden_beside_a_step.py --inertia 60 [--first-seed N] [--jobs N] [--write]

Lines of other equations than the product's (`tests/independent_line`), run through a production profile: a ramp,
constant speed, E +20.7 % at 23 s. `--drawn` draws so many cases instead: what is hidden and its size, machine, speed,
profile, rows, noise, and the step. `--inertia` draws inertia, scale of the torque and friction in such machines: what
the twin tells of the inertia. `--write` puts the table into docs/tables and a summary into the page.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).parents[1]))

import docs_page
from tests.estimation.hidden_beside_a_step import (
    CASES,
    Accelerated,
    Drawn,
    Outcome,
    accelerated,
    drawn,
    outcome,
    outcome_of,
)

from hilbench.estimation.web_line.config import ChangepointConfig

DURATION_S = 40.0


def run(name: str) -> Outcome:
    """One case."""
    return outcome(name, ChangepointConfig(), duration_s=DURATION_S)


def run_drawn(seed: int) -> tuple[Drawn, Outcome]:
    """One that is drawn."""
    case = drawn(seed)
    return case, outcome_of(case.line, ChangepointConfig(), case.profile, seed=seed, duration_s=case.duration_s)


def rows(outcomes: dict[str, Outcome]) -> list[list[str]]:
    """Of the table, a row a case."""
    found = []
    for name, of in outcomes.items():
        time_s = "–" if of.time_to_1pct_s is None else f"{of.time_to_1pct_s:.3g}"
        over = "–" if of.overshoot_pct is None else f"{of.overshoot_pct:.2g}"
        found.append([name, time_s, over, _end(of), f"{100.0 * of.covered:.1f}"])
    return found


def _end(of: Outcome) -> str:
    return f"{of.end_pct:.2f} % ± {of.stated_pct:.1f}".replace("-", "−")


def summary(rows: list[docs_page.Row]) -> str:
    """Cases within 1 %, and those that are more than 3 % off at the end."""
    within = [f"{row[HIDDEN]} ({row['to 1 % in s']} s)" for row in rows if row["to 1 % in s"] != "–"]
    off = [row for row in rows if abs(float(row[END].split()[0].replace("−", "-"))) > 3.0]
    shown = (HIDDEN, END, "95 % holds in %")
    table = docs_page.markdown(shown, [[row[title] for title in shown] for row in off])
    return f"Within 1 % for good: {'; '.join(within)}. At the end more than 3 % off:\n\n{table}"


HIDDEN, END = "hidden beside the step", "end of run"
TABLE = docs_page.Table(
    "hidden_beside_a_step",
    "compare_methods.md",
    (HIDDEN, "to 1 % in s", "overshoot in %", END, "95 % holds in %"),
    summary,
)


def drawn_text(first_seed: int, found: list[tuple[Drawn, Outcome]]) -> str:
    """How many are right, by what is hidden."""
    of, right = Counter[str](), Counter[str]()
    for case, ended in found:
        for name in {str(hidden["effect"]) for hidden in case.hidden} or {"nothing"}:
            of[name] += 1
            right[name] += ended.right
    total, held = sum(ended.right for _, ended in found), sum(ended.covered for _, ended in found) / len(found)
    wrong = [f"{name} {right[name]} of {of[name]}" for name in sorted(of) if right[name] < of[name]]
    return (
        f"Seeds {first_seed} to {first_seed + len(found) - 1}: {total} of {len(found)} right, the interval holds in "
        f"{100.0 * held:.1f} % of all cycles. Not always right: {', '.join(wrong) or 'none'}."
    )


def drawn_rows(found: list[tuple[Drawn, Outcome]]) -> list[list[str]]:
    """Of those that are not right."""
    wrong = [(case, ended) for case, ended in found if not ended.right]
    return [[f"{case.seed}: {case}", _end(ended), f"{100.0 * ended.covered:.1f}"] for case, ended in wrong]


def drawn_summary(rows: list[docs_page.Row]) -> str:
    """Seeds, and where the interval holds least."""
    least = min((row["95 % holds in %"] for row in rows), key=float, default="100.0")
    seeds = ", ".join(row[DRAWN].partition(":")[0] for row in rows)
    return f"Not right: seeds {seeds}, where the interval holds in {least} % of the cycles at least."


DRAWN = "not right: seed, hidden"
DRAWN_TABLE = docs_page.Table(
    "drawn_beside_a_step", "compare_methods.md", (DRAWN, END, "95 % holds in %"), drawn_summary
)


def inertia_table(first_seed: int, found: list[Accelerated]) -> str:
    """How well the inertia is told, by the profile."""
    lines = [
        f"Seeds {first_seed} to {first_seed + len(found) - 1}:",
        "",
        "| run | separable in | 95 % interval, median | holds in | largest error over deviation |",
        "|---|--:|--:|--:|--:|",
    ]
    for profile in sorted({each.profile for each in found}):
        of = [each for each in found if each.profile == profile]
        told = [each for each in of if each.found.separable]
        half_pct = 196.0 * median(each.found.deviation for each in told)
        worst = max(abs(each.found.value - each.true) / each.found.deviation for each in told)
        held = sum(each.held for each in told)
        lines.append(f"| {profile} | {len(told)} of {len(of)} | ± {half_pct:.1f} % | {held} | {worst:.1f} |")
    return "\n".join(lines)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drawn", type=int, metavar="N")
    parser.add_argument("--inertia", type=int, metavar="N")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="into docs/tables and the page")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + (options.drawn or options.inertia or 0))
    with ProcessPoolExecutor(options.jobs) as pool:
        if options.drawn:
            found = list(pool.map(run_drawn, seeds))
            print(drawn_text(options.first_seed, found), docs_page.markdown(DRAWN_TABLE.columns, drawn_rows(found)))
            if options.write:
                docs_page.put(docs_page.DOCS / DRAWN_TABLE.page, "drawn", drawn_text(options.first_seed, found))
                DRAWN_TABLE.write(drawn_rows(found))
        elif options.inertia:
            text = inertia_table(options.first_seed, list(pool.map(accelerated, seeds)))
            print(text)
            if options.write:
                docs_page.put(docs_page.DOCS / "history.md", "inertia", text)
        else:
            table = rows(dict(zip(CASES, pool.map(run, CASES), strict=True)))
            print(docs_page.markdown(TABLE.columns, table))
            if options.write:
                TABLE.write(table)


if __name__ == "__main__":
    main()
