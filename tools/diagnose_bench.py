"""What `hilbench diagnose` finds on benches that hide something: every `bench_configs/hidden_*.yaml`, as a table.

    diagnose_bench.py [--docs FILE] [CONFIG …]

Each config is run, diagnosed, and run again with the extended model; that takes about a minute each.
`--docs` writes the table into the page.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import docs_page
import yaml

ROOT = Path(__file__).resolve().parents[1]
HEAD = (
    "| config | hidden | found (95 %) | torque residual, N·m | simulated less true tension, N, or friction, N·m |"
    " bias of E, or of the inertia, % |\n"
    "|---|---|---|---|---|---|"
)

#: What is shown of a run, by whichever of these its machine has.
FIGURES = (
    ("torque_residual_rms_Nm",),
    ("tension_deviation_mean_N", "friction_deviation_mean_Nm"),
    ("E_bias_pct", "J_bias_pct"),
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


def row(config: Path) -> str:
    """One line of the table."""
    there = "; ".join(f"{place(e)} {', '.join(f'{v:g}' for v in e['parameters'].values())}" for e in hidden(config))
    result = diagnosed(config)
    found = []
    for effect in result["effects"]:
        values = [f"{v['value']:.4g} ({v['ci95'][0]:.4g} to {v['ci95'][1]:.4g})" for v in effect["parameters"].values()]
        tied = f", tied with {', '.join(effect['tied_with'])}" if effect["tied_with"] else ""
        found.append(f"{place(effect)} {', '.join(values)}{tied}")
    live = []
    for names in FIGURES:
        live.append(" → ".join(f"{run[name]:.3g}" for run in result["live"] for name in names if name in run))
    return f"| {config.stem} | {there} | {'; '.join(found) or result['verdict']} | {' | '.join(live)} |"


def main() -> None:
    """Run all and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("configs", nargs="*", type=Path, default=sorted((ROOT / "bench_configs").glob("hidden_*.yaml")))
    parser.add_argument("--docs", type=Path, help="page that gets the table")
    options = parser.parse_args()
    print(HEAD, flush=True)
    lines = [HEAD]
    for config in options.configs:
        lines.append(row(config))
        print(lines[-1], flush=True)
    if options.docs is not None:
        docs_page.put(options.docs, "bench", "\n".join(lines))


if __name__ == "__main__":
    main()
