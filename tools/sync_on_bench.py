"""Every synchronizer on the running bench, as a table.

    sync_on_bench.py [--jobs N] [--write]

What `hilbench sync bench_configs/synchronizers.yaml` says: a run with each method, the tension loop closed on its twin.
`--write` puts it into docs/tables and a summary into the page.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import docs_page

CONFIG = Path(__file__).parents[1] / "bench_configs" / "synchronizers.yaml"


def compared(jobs: int) -> dict[str, Any]:
    """What the command prints with `--json`."""
    with TemporaryDirectory() as folder:
        command = ["sync", str(CONFIG), "--json", "--jobs", str(jobs), "--out", folder]
        done = subprocess.run([sys.executable, "-m", "hilbench", *command], check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def figure(value: float | None) -> str:
    """For the eye."""
    return "–" if value is None else f"{value:.3g}".replace("-", "−")


def rows(found: dict[str, Any]) -> list[list[str]]:
    """A row a method, and one of the bound."""
    lines = []
    for of in found["methods"]:
        names = ("time_to_1pct_s", "overshoot_pct", "noise_pct", "bias_pct")
        cells = [figure(of[name]) for name in names]
        E_Pa, sd_Pa = of["final_E_Pa"], of["final_deviation_Pa"]
        cells += [figure(100.0 * of["covered"]), f"{1e-6 * E_Pa:.0f}", figure(100.0 * sd_Pa / E_Pa)]
        lines.append([of["method"], *cells])
    bound, E_Pa = found["bound"], median(of["final_E_Pa"] for of in found["methods"])
    sd_pct = figure(100.0 * bound["final_deviation_Pa"] / E_Pa)
    return [*lines, ["Cramér–Rao bound", figure(bound["time_to_1pct_s"]), *"–––––", sd_pct]]


COLUMNS = (
    "method",
    "to 1 % in s",
    "overshoot in %",
    "noise in %",
    "bias in %",
    "95 % holds in %",
    "E in N/mm²",
    "± in %",
)
SHOWN = ("method", "to 1 % in s", "overshoot in %", "E in N/mm²", "± in %")
TABLE = docs_page.Table(
    "sync_on_bench",
    "compare_methods.md",
    COLUMNS,
    lambda rows: docs_page.markdown(SHOWN, [[row[title] for title in SHOWN] for row in rows]),
)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    found = rows(compared(options.jobs))
    print(docs_page.markdown(COLUMNS, found))
    if options.write:
        TABLE.write(found)


if __name__ == "__main__":
    main()
