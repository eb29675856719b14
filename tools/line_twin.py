"""How well twin and controllers of the shipped line of three spans know and keep each span by itself.

    line_twin.py [--seeds N] [--write]

Each seed runs bench_configs/line_three_spans.yaml in this process at 2 m/s, with a step of E in each span, of all at
once up and down, and a step of each set-point by 10 N. How far E of other spans moves is told twice: of what it was
before the step, and of what it is at that time in a run of the same seed without the step, which has the same noise.
Prints the worst of the seeds; `--write` writes it into docs/tables and the page.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import docs_page
import numpy as np
from numpy.typing import NDArray

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[1] / "bench_configs" / "line_three_spans.yaml"
SPANS = (1, 2, 3)
FIRST_S, EACH_S, BEFORE_S = 5.0, 3.0, 0.3
#: What is stepped, its path, to what, and the spans that it is meant for.
STEPS: tuple[tuple[str, str, float, tuple[int, ...]], ...] = (
    *((f"E of span {k} +20.7 %", f"load.web.span{k}.youngs_modulus_Pa", 10.5e9, (k,)) for k in SPANS),
    ("E of all spans −17.1 %", "load.web.youngs_modulus_Pa", 8.7e9, SPANS),
    ("E of all spans +20.7 %", "load.web.youngs_modulus_Pa", 10.5e9, SPANS),
    *(
        (f"set-point of span {k} +10 N", f"tension_control.span{k}.set_point_N", to_N, (k,))
        for k, to_N in zip(SPANS, (90.0, 95.0, 100.0), strict=True)
    ),
)
Array = NDArray[np.float64]


def run(seed: int, without: int | None = None) -> dict[str, Array]:
    """The recording of a seed; or one that ends where the next step after number `without` would be, without that."""
    steps: list[dict[str, Any]] = [{"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 2.0}}]
    steps.append({"hold": {"until_s": FIRST_S}})
    for number, (_, path, to, _) in enumerate(STEPS[: None if without is None else without + 1]):
        steps += [{"step": {"path": path, "to": to}}] if number != without else []
        steps.append({"hold": {"duration_s": EACH_S}})
    with TemporaryDirectory() as folder:
        bus = f"embedded:{Path(folder).name}"
        given = load_with_overrides(CONFIG, bus=bus, changes=[f"steps={steps}", "criteria=[]", f"seed={seed}"])
        outcome = run_experiment(given, Path(folder), participants=Participants.IN_PROCESS)
        channels = read_recording(outcome.folder.recording).channels
        return {name: np.asarray(values) for name, values in channels.items()}


def moved_by(found: dict[str, Array], without: dict[str, Array], number: int) -> float:
    """How far E of the other spans is from what it is without a step, %."""
    at_s = FIRST_S + number * EACH_S
    now = [(each["t_s"] >= at_s) & (each["t_s"] < at_s + EACH_S) for each in (found, without)]
    count = min(int(np.count_nonzero(rows)) for rows in now)
    moved = []
    for span in set(SPANS) - set(STEPS[number][3]):
        moduli_Pa = [each[f"E{span}_sim_Pa"][rows][:count] for each, rows in zip((found, without), now, strict=True)]
        moved.append(float(np.max(np.abs(moduli_Pa[0] / moduli_Pa[1] - 1.0))))
    return 100.0 * max(moved, default=0.0)


def figures(found: dict[str, Array], number: int) -> tuple[float, ...]:
    """Of a step: time until E of its spans is within 1 % for good, s; how far E of others moves, %; time until all
    tensions are within 1 N for good, s; how far the tensions of other spans go, N."""
    at_s, meant = FIRST_S + number * EACH_S, STEPS[number][3]
    t = found["t_s"]
    now, before = (t >= at_s) & (t < at_s + EACH_S), (t >= at_s - BEFORE_S) & (t < at_s)
    known_s = kept_s = moved_pct = disturbed_N = 0.0
    for span in SPANS:
        error = found[f"E{span}_sim_Pa"] / found[f"E{span}_true_Pa"] - 1.0
        off_N = np.abs(found[f"F{span}_true_N"] - found[f"F{span}_ref_N"])[now]
        kept_s = max(kept_s, _for_good(t[now] - at_s, off_N > 1.0))
        if span in meant:
            known_s = max(known_s, _for_good(t[now] - at_s, np.abs(error[now]) > 0.01))
        else:
            moved_pct = max(moved_pct, 100.0 * float(np.max(np.abs(error[now] - np.mean(error[before])))))
            disturbed_N = max(disturbed_N, float(np.max(off_N)))
    return known_s, moved_pct, kept_s, disturbed_N


def _for_good(after_s: Array, outside: NDArray[np.bool_]) -> float:
    """When something is outside for the last time."""
    return float(after_s[outside][-1]) if np.any(outside) else 0.0


def rows(seeds: int) -> list[list[str]]:
    """The worst of each step."""
    each = [run(seed) for seed in range(1, seeds + 1)]
    lines = []
    for number, (name, _, _, meant) in enumerate(STEPS):
        cells = [f"{value:.2g}" for value in np.max([figures(found, number) for found in each], axis=0)]
        if meant == SPANS:
            cells[1] = cells[3] = by_it = "–"
        else:
            pairs = [(found, run(seed, number)) for seed, found in enumerate(each, 1)]
            by_it = f"{max(moved_by(found, without, number) for found, without in pairs):.2g}"
        cells.insert(2, by_it)
        lines.append([name, *cells])
    return lines


SHOWN = ("worst of each step", "E within 1 %, s", "all tensions within 1 N, s", "other tensions off, N")
TABLE = docs_page.Table(
    "line_twin",
    "lines.md",
    (*SHOWN[:2], "E of others moves, %", "by the step, %", *SHOWN[2:]),
    lambda rows: docs_page.markdown(SHOWN, [[row[title] for title in SHOWN] for row in rows]),
)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    found = rows(options.seeds)
    print(docs_page.markdown(TABLE.columns, found))
    if options.write:
        TABLE.write(found)


if __name__ == "__main__":
    main()
