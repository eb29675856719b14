"""What a twin makes of a step of E whose model lacks something: a table.

    hidden_beside_a_step.py [--jobs N] [--write docs/synchronization.md]
    hidden_beside_a_step.py --drawn 60 [--first-seed N] [--jobs N] [--write docs/synchronization.md]
    hidden_beside_a_step.py --inertia 60 [--first-seed N] [--jobs N] [--write docs/history.md]

Lines of other equations than the product's (`tests/independent_line`), run through a production profile: a ramp,
constant speed, E +20.7 % at 23 s. `--drawn` draws so many cases instead: what is hidden and its size, machine, speed,
profile, rows, noise, and the step. `--inertia` draws inertia, scale of the torque and friction in such machines: what
the twin tells of the inertia. `--write` puts the table between the marker lines of the page.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable
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


def table(outcomes: dict[str, Outcome]) -> str:
    """In Markdown."""
    lines = [
        "| hidden beside the step | to 1 % in s | overshoot in % | end of run | 95 % holds in % |",
        "|---|--:|--:|--:|--:|",
    ]
    for name, found in outcomes.items():
        time_s = "–" if found.time_to_1pct_s is None else f"{found.time_to_1pct_s:.3g}"
        over = "–" if found.overshoot_pct is None else f"{found.overshoot_pct:.2g}"
        end = f"{found.end_pct:.2f} % ± {found.stated_pct:.1f}".replace("-", "−")
        lines.append(f"| {name} | {time_s} | {over} | {end} | {100.0 * found.covered:.1f} |")
    return "\n".join(lines)


def drawn_table(first_seed: int, found: list[tuple[Drawn, Outcome]]) -> str:
    """How many are right, by what is hidden, and those that are not."""
    of, right = Counter[str](), Counter[str]()
    for case, ended in found:
        for name in {str(hidden["effect"]) for hidden in case.hidden} or {"nothing"}:
            of[name] += 1
            right[name] += ended.right
    total, held = sum(ended.right for _, ended in found), sum(ended.covered for _, ended in found) / len(found)
    lines = [
        f"Seeds {first_seed} to {first_seed + len(found) - 1}: {total} of {len(found)} right, the interval holds in "
        f"{100.0 * held:.1f} % of all cycles. By what was hidden: "
        + ", ".join(f"{name} {right[name]} of {of[name]}" for name in sorted(of))
        + ".",
        "",
        "| not right: seed, hidden | end of run | 95 % holds in % |",
        "|---|--:|--:|",
    ]
    for case, ended in found:
        if not ended.right:
            end = f"{ended.end_pct:.2f} % ± {ended.stated_pct:.1f}".replace("-", "−")
            lines.append(f"| {case.seed}: {case} | {end} | {100.0 * ended.covered:.1f} |")
    return "\n".join(lines)


def inertia_table(first_seed: int, found: list[Accelerated]) -> str:
    """How well the inertia is told, by the profile."""
    lines = [
        f"Seeds {first_seed} to {first_seed + len(found) - 1}:",
        "",
        "| run | told in | 95 % interval, median | holds in | largest error over deviation |",
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
    """Run and print, or write into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drawn", type=int, metavar="N")
    parser.add_argument("--inertia", type=int, metavar="N")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    make: Callable[[ProcessPoolExecutor], str]
    if options.drawn:
        seeds = range(options.first_seed, options.first_seed + options.drawn)
        mark, make = "drawn", lambda pool: drawn_table(options.first_seed, list(pool.map(run_drawn, seeds)))
    elif options.inertia:
        seeds = range(options.first_seed, options.first_seed + options.inertia)
        mark, make = "inertia", lambda pool: inertia_table(options.first_seed, list(pool.map(accelerated, seeds)))
    else:
        mark, make = "hidden", lambda pool: table(dict(zip(CASES, pool.map(run, CASES), strict=True)))
    with ProcessPoolExecutor(options.jobs) as pool:
        found = make(pool)
    if options.write is None:
        print(found)
    else:
        docs_page.put(options.write, mark, found)


if __name__ == "__main__":
    main()
