"""What a twin makes of a step of E whose model lacks something: a table.

    hidden_beside_a_step.py [--jobs N] [--write docs/synchronization.md]

Lines of other equations than the product's (`tests/independent_line`), run through a production profile: a ramp,
constant speed, E +20.7 % at 23 s. `--write` puts the table between the marker lines of the page.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import docs_page
from tests.estimation.hidden_beside_a_step import CASES, Outcome, outcome

from hilbench.estimation.web_line.config import ChangepointConfig

DURATION_S = 40.0


def run(name: str) -> Outcome:
    """One case."""
    return outcome(name, ChangepointConfig(), duration_s=DURATION_S)


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


def main() -> None:
    """Run and print, or write into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        found = table(dict(zip(CASES, pool.map(run, CASES), strict=True)))
    if options.write is None:
        print(found)
    else:
        docs_page.put(options.write, "hidden", found)


if __name__ == "__main__":
    main()
