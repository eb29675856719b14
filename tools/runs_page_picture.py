"""Draw the picture of docs/runs.md: the page of a library of runs, in Debian's chromium.

    python tools/runs_page_picture.py docs/images/runs.png

The runs are made: seeded figures, a config and a result each.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from hilbench.apps.library.index import RunEntry
from hilbench.apps.library.runs_page import write_runs_page

_RUNS = 900
_BEGAN_S = 1_767_600_000.0
_APART_S = 9 * 3600.0


def runs() -> list[RunEntry]:
    """A stand's runs of a year whose E took longer to find until a belt was exchanged; the newest first."""
    random = np.random.default_rng(0)
    made = []
    for number in range(_RUNS):
        since = number % 600 / 600
        time_s = 0.118 + 0.06 * since**3 + random.normal(0.0, 0.008)
        passed = time_s < 0.18
        began_s = _BEGAN_S + _APART_S * number
        metrics = {"E_time_to_1pct_s": time_s, "E_noise_pct": 0.011 + random.normal(0.0, 0.001)}
        entry = RunEntry(
            path=f"web_section_step-{number:04d}",
            bench="web_section_step",
            began_s=began_s,
            state="passed" if passed else "failed",
            duration_s=54.8,
            met=7 if passed else 6,
            criteria=7,
            has_report=True,
            tags=("golden",) if number == _RUNS - 3 else (),
            notes=("new belt on axis 2",) if number == 600 else (),
            metrics=metrics,
        )
        made.append(entry)
    return made[::-1]


def main() -> None:
    """Write the picture to the file that is named."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = write_runs_page(Path(folder) / "runs", runs(), Path(folder) / "runs.html")
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 1100, "height": 900})
        shown.goto(page.as_uri())
        shown.select_option("#metric", "E_time_to_1pct_s")
        shown.screenshot(path=sys.argv[1])
        browser.close()


if __name__ == "__main__":
    main()
