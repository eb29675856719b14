"""What `hilbench diagnose` finds on benches that hide something: every `bench_configs/hidden_*.yaml`, as a table.

    diagnose_bench.py [--write] [CONFIG …]

Each config is run, diagnosed, and run again with the extended model; that takes about a minute each.
`--write` writes the table, and its summary on the page.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import docs_page
import yaml

ROOT = Path(__file__).resolve().parents[1]
#: What is shown of a run; of several axes or spans the largest.
FIGURES = (
    re.compile(r"torque_residual(_axis\d)?_rms_Nm"),
    re.compile(r"tension\d?_deviation_mean_N|friction_deviation_mean_Nm"),
    re.compile(r"[EJ]\d?_bias_pct"),
)


def diagnosed(config: Path) -> dict[str, Any]:
    """The object that the command prints. Raises CalledProcessError."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "hilbench", "diagnose", str(config), "--out", folder, "--json"]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def hidden(config: Path) -> Iterator[dict[str, Any]]:
    """The effects that a config hides."""
    document = yaml.safe_load(config.read_text(encoding="utf-8"))
    for part in ("hardware", "load"):
        yield from document.get(part, {}).get("effects", [])


def place(effect: dict[str, Any]) -> str:
    """Name and axis."""
    return str(effect["effect"]) + (f" (axis {effect['axis']})" if effect.get("axis") else "")


def row(config: Path) -> list[str]:
    """Of the table."""
    there = "; ".join(f"{place(e)} {', '.join(f'{v:g}' for v in e['parameters'].values())}" for e in hidden(config))
    result = diagnosed(config)
    found = []
    for effect in result["effects"]:
        values = [f"{v['value']:.4g} ({v['ci95'][0]:.4g} to {v['ci95'][1]:.4g})" for v in effect["parameters"].values()]
        tied = f", tied with {', '.join(effect['tied_with'])}" if effect["tied_with"] else ""
        found.append(f"{place(effect)} {', '.join(values)}{tied}")
    live = []
    for figure in FIGURES:
        of_runs = ([value for name, value in run.items() if figure.fullmatch(name)] for run in result["live"])
        live.append(" → ".join(f"{max(values, key=abs):.3g}" for values in of_runs if values))
    return [config.stem, there, "; ".join(found) or result["verdict"], *live]


def summary(rows: list[docs_page.Row]) -> str:
    """How many were named, and the largest errors on the running bench before and after."""
    named = [row for row in rows if row["hidden"].split()[0] in row["found (95 %)"]]
    return (
        f"Named: {len(named)} of {len(rows)}. Largest error of the simulated tension: {_largest(rows, TENSION)} N; "
        f"largest bias of E, or of the inertia: {_largest(rows, BIAS)} %."
    )


def _largest(rows: list[docs_page.Row], column: str) -> str:
    return " → ".join(max(values, key=lambda value: abs(float(value))) for values in _before_and_after(rows, column))


def _before_and_after(rows: list[docs_page.Row], column: str) -> Iterator[tuple[str, ...]]:
    yield from zip(*(row[column].split(" → ") for row in rows if row[column]), strict=True)


TENSION, BIAS = "simulated less true tension, N, or friction, N·m", "bias of E, or of the inertia, %"
TABLE = docs_page.Table(
    "hidden_benches",
    "diagnosis_method.md",
    ("config", "hidden", "found (95 %)", "torque residual, N·m", TENSION, BIAS),
    summary,
)


def main() -> None:
    """Run all and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configs", nargs="*", type=Path, default=sorted((ROOT / "bench_configs").glob("hidden_*.yaml")))
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    rows = []
    for config in options.configs:
        rows.append(row(config))
        print(*rows[-1], sep=" | ", flush=True)
    if options.write:
        TABLE.write(rows)


if __name__ == "__main__":
    main()
