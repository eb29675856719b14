"""The swing of roller 2 against the web after steps of E, with and without active damping, and the loop's margins.

    python tools/tension_swing.py              print the tables
    python tools/tension_swing.py --write      write them into docs/tables, a summary into docs/theory.md

The runs are those of bench_configs/web_section_step.yaml in one process: line speed, 2 s at rest, the step. "Other
side": how far the true tension goes beyond its set-point after the step has pushed it the other way. "Swing": the
tension less its mean over 0.1 s, from 0.15 s after the step on. "Within 1 N": for good.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import docs_page
import numpy as np

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.tension_loop import OperatingPoint, TensionLoop
from hilbench.runs.config import load_with_overrides
from hilbench.runs.figures import time_to_stay

CONFIG = Path(__file__).resolve().parents[1] / "bench_configs" / "web_section_step.yaml"
UNDAMPED = "controllers.tension_control.swing_damping_ratio=0"
STEPS, SPEEDS_M_S = (-0.4, -0.207, -0.1, -0.02, 0.02, 0.1, 0.207, 0.4), (0.5, 3.0, 8.0)
MODULUS_PA, AFTER_S, SWING_S, MEAN_S, BAND = 8.7e9, 1.8, 0.15, 0.1, 0.01


def run(share: float, speed_m_s: float, *changes: str) -> list[float | None]:
    """Other side (N), swing (N), time to 1 N (s), time of the estimate to 1 % (s), noise before the step (N)."""
    wide = "safety.limits.speed_m_s.warning=9"
    bench = Bench(CONFIG, changes=[wide, *changes], participants=Participants.IN_PROCESS)
    with bench:
        bench.ramp("line_speed_m_s", speed_m_s, duration_s=max(1.0, 0.5 * speed_m_s))
        bench.run(2.0)
        step_s = bench.time_s
        bench.step("load.web.youngs_modulus_Pa", MODULUS_PA * (1.0 + share))
        bench.run(AFTER_S)
    recording = bench.recording
    since = recording.time_s - step_s
    error_N = recording["F_true_N"] - recording["F_ref_N"]
    start = int(np.searchsorted(since, 1e-9))
    width = round(MEAN_S / bench.config.cycle_time_s) | 1
    swing_N = (error_N - np.convolve(error_N, np.full(width, 1.0 / width), "same"))[: -(width // 2)]
    estimate = recording["E_sim_Pa"] / recording["E_true_Pa"] - 1.0
    return [
        max(0.0, float(np.max(-np.sign(share) * error_N[start:]))),
        float(np.max(np.abs(swing_N[since[: len(swing_N)] >= SWING_S]))),
        time_to_stay(recording.time_s, error_N, 1.0, start),
        time_to_stay(recording.time_s, estimate, BAND, start),
        float(np.std(error_N[(since > -1.0) & (since <= 0.0)])),
    ]


def swing_rows() -> list[list[str]]:
    """Both ways of each step and speed."""
    found = []
    for share in STEPS:
        for speed_m_s in SPEEDS_M_S:
            pairs = zip(run(share, speed_m_s, UNDAMPED), run(share, speed_m_s), strict=True)
            cells = [" → ".join("–" if value is None else f"{value:.2g}" for value in pair) for pair in pairs]
            found.append([f"{100 * share:+g} %", f"{speed_m_s:g}", *cells])
    return found


def margin_rows() -> list[list[str]]:
    """Margins at axis 1's command, for E as true and for the old E that the twin believes just after a step."""
    undamped, damped = (load_with_overrides(CONFIG, changes=changes).config for changes in ([UNDAMPED], []))
    found = []
    for share in (-0.4, 0.0, 0.4):
        for speed_m_s in SPEEDS_M_S:
            cells = []
            for believed in (1.0 + share, 1.0):
                point = OperatingPoint((MODULUS_PA * (1.0 + share),), speed_m_s, (1.0,), (MODULUS_PA * believed,))
                before, after = (TensionLoop(config, point).margins for config in (undamped, damped))
                cells.append(f"{before.gain:.2f} → {after.gain:.2f}")
                cells.append(f"{before.phase_deg:.0f} → {after.phase_deg:.0f}")
            found.append([f"{100 * share:+g} %", f"{speed_m_s:g}", *cells])
    return found


def at_3_m_s(*titles: str, least_pct: float = 0.0) -> Callable[[list[docs_page.Row]], str]:
    """These columns of the rows of 3 m/s and of steps of this size and more, in the first column."""

    def made(rows: list[docs_page.Row]) -> str:
        shown = [row for row in rows if row["m/s"] == "3" and abs(float(row[titles[0]].split()[0])) >= least_pct]
        return docs_page.markdown(titles, [[row[title] for title in titles] for row in shown])

    return made


MARGINS = docs_page.Table(
    "margins",
    "theory.md",
    ("E", "m/s", "gain, E known", "phase, °", "gain, old E", "phase, old E, °"),
    at_3_m_s("E", "gain, E known", "phase, °", "gain, old E", "phase, old E, °"),
)
SWING = docs_page.Table(
    "swing",
    "theory.md",
    ("step of E", "m/s", "other side, N", "swing, N", "within 1 N, s", "E to 1 %, s", "noise, N"),
    at_3_m_s("step of E", "other side, N", "swing, N", "within 1 N, s", least_pct=20.0),
)


def main() -> None:
    """Run, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write swing.csv, margins.csv and docs/theory.md")
    write = parser.parse_args().write
    for table, rows in ((MARGINS, margin_rows()), (SWING, swing_rows())):
        print(docs_page.markdown(table.columns, rows), end="\n\n")
        if write:
            table.write(rows)


if __name__ == "__main__":
    main()
