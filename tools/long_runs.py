"""Long runs of four machines in one process each: memory, handles, threads, files and speed, as a table.

    python tools/long_runs.py                  an hour of each, the table on the terminal
    python tools/long_runs.py --hours 8        a night
    python tools/long_runs.py --write          puts the table into docs/performance.md too

The exit code is 1 when a run failed, or when what its process holds grew.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import docs_page
import yaml
from soak import Held, Series

ROOT = Path(__file__).resolve().parents[1]
#: Configs, the quantity that moves the machine, and how fast it goes.
MACHINES = {
    "web_section_step": ("line_speed_m_s", 3.0),
    "line_three_spans": ("line_speed_m_s", 2.0),
    "line_with_dancer": ("line_speed_m_s", 2.0),
    "servo_axis": ("speed_rad_s", 20.0),
}
_LOOK_S = 1.0
#: Growth of the memory behind the warm-up that a run may show: caches of what is rare fill.
_ALLOWED_KB = 5000
#: More than a recording has before its first samples.
_HEAD_BYTES = 100_000


@dataclass
class LongRun:
    """One machine for so many hours of simulated time, at its speed."""

    name: str
    hours: float
    series: Series = field(init=False)
    speed: float = 0.0
    files_MB: dict[str, float] = field(default_factory=dict)
    problem: str = ""

    def __post_init__(self) -> None:
        self.series = Series(self.name)

    def run(self, folder: Path) -> None:
        """Raises OSError."""
        path, speed = MACHINES[self.name]
        steps = [
            {"ramp": {"path": path, "to": speed, "duration_s": 4.0}},
            {"hold": {"duration_s": 3600.0 * self.hours}},
            {"ramp": {"path": path, "to": 0.0, "duration_s": 4.0}},
        ]
        config = folder / f"{self.name}.yaml"
        base = str(ROOT / "bench_configs" / f"{self.name}.yaml")
        config.write_text(yaml.safe_dump({"include": base, "steps": steps, "criteria": []}), encoding="utf-8")
        command = [sys.executable, "-m", "hilbench", "run", str(config), "--in-process", "--json"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder) as process:
            runs = folder / "runs"
            while process.poll() is None:
                # From the first piece on, and while the run goes on: what comes before and behind it may take more.
                if any(_size(path) > _HEAD_BYTES for path in runs.glob("*/recording.part.mf4")):
                    self._look(process.pid)
                time.sleep(_LOOK_S)
            said = process.stdout.read() if process.stdout is not None else ""
        self._take(json.loads(said) if process.returncode == 0 else None)

    def _look(self, pid: int) -> None:
        try:
            self.series.held.append(Held.by(pid))
        except OSError:
            return  # it has just ended

    def _take(self, result: dict[str, Any] | None) -> None:
        if result is None:
            self.problem = f"{self.name}: the run failed"
            return
        self.speed = result["timing"]["realtime_factor"]
        for path in Path(result["run"]).iterdir():
            kind = path.name.partition(".")[0]
            self.files_MB[kind] = self.files_MB.get(kind, 0.0) + path.stat().st_size / 1e6

    def cells(self) -> list[str]:
        """A row of the table."""
        held = ["{} → {}".format(*self.series.before_and_after(each)) for each in ("memory_kB", "handles", "threads")]
        files = [f"{self.files_MB.get(each, 0.0):.0f}" for each in ("recording", "trace")]
        report = f"{self.files_MB.get('report', 0.0):.1f}"
        return [self.name, f"{self.speed:.0f} ×", *held, *files, report]


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # it has its final name by now
        return 0


SHOWN = ("machine", "speed", "memory, kB", "recording, MB", "trace, MB")
TABLE = docs_page.Table(
    "long_runs",
    "performance.md",
    ("machine", "speed", "memory, kB", "file handles", "threads", "recording, MB", "trace, MB", "report, MB"),
    lambda rows: docs_page.markdown(SHOWN, [[row[title] for title in SHOWN] for row in rows]),
)


def main() -> int:
    """Run, print, and put the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="simulated time of each machine")
    parser.add_argument("--only", choices=sorted(MACHINES), help="one of the machines")
    parser.add_argument("--write", action="store_true", help="write the table into docs/performance.md")
    options = parser.parse_args()
    rows, problems = [], []
    for name in [options.only] if options.only else MACHINES:
        run = LongRun(name, options.hours)
        with tempfile.TemporaryDirectory(prefix="long-run-") as folder:
            run.run(Path(folder))
        problems += [run.problem] if run.problem else run.series.grew(_ALLOWED_KB)
        if not run.problem:
            rows.append(run.cells())
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    last = "; ".join(problems) or f"Nothing grew, but for memory by up to {_ALLOWED_KB} kB."
    text = f"{options.hours:g} h of each. {last}"
    print(text, docs_page.markdown(TABLE.columns, rows), sep="\n\n")
    if options.write:
        docs_page.put(docs_page.DOCS / TABLE.page, "long runs", text)
        TABLE.write(rows)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
