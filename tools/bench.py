"""How fast hilbench is beside what one would use instead.

    bench.py [CONFIG] [--only PART,...] [--seconds S] [--json FILE] [--write]

Prints tables, writes them as JSON, and with --write into docs/tables, with a summary on the page; with --only the
other sections there stay.
What counts are the ratios: both sides of each were measured in the same run on the same machine.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # simulated data lie with the tests

import docs_page
from performance import cyclic_path, model_kernel, real_time, recordings, running, streams, twin
from performance.table import TABLE, Section, machine, machine_table, renewed, rows

from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).parents[1] / "bench_configs" / "web_section_step.yaml"
PARTS = "kernel, pdo, streams, twin, lockstep, machines, jitter, fast, sync, diagnose, start"
MACHINES = [
    "web_section_step",
    "line_two_spans",
    "line_three_spans",
    "line_with_dancer",
    "winding_line",
    "koc_2002",
    "kuhm_2012",
    "servo_axis",
]
LENGTHS_S = [12.0, 24.0, 48.0]


def parts(config_path: Path, seconds: float) -> dict[str, Callable[[], list[Section]]]:
    """What can be measured, by name."""
    config = load_with_overrides(config_path).config
    return {
        "kernel": lambda: model_kernel.measure(config.web_line),
        "pdo": lambda: [cyclic_path.measure(config)],
        "streams": lambda: [streams.measure(config)],
        "twin": lambda: [twin.measure(config.web_line)],
        "lockstep": lambda: [running.lockstep(config_path, seconds)],
        "machines": lambda: [running.machines([CONFIG.with_stem(name) for name in MACHINES])],
        "jitter": lambda: real_time.measure(config_path, seconds),
        "fast": lambda: real_time.measure_fast(config_path, seconds),
        "sync": lambda: [recordings.synchronizers(config.web_line, LENGTHS_S)],
        "diagnose": lambda: [recordings.diagnosis(config.web_line, LENGTHS_S)],
        "start": lambda: [running.start_up(config_path)],
    }


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", nargs="?", type=Path, default=CONFIG)
    parser.add_argument("--only", help=f"parts, by commas: {PARTS}")
    parser.add_argument("--seconds", type=float, default=60.0, help="of lockstep, jitter and fast")
    parser.add_argument("--json", type=Path, default=Path("performance.json"), help="where the figures go")
    parser.add_argument("--write", action="store_true", help=f"write {TABLE.file.name} and docs/{TABLE.page}")
    options = parser.parse_args()
    known = parts(options.config, options.seconds)
    chosen = options.only.split(",") if options.only else list(known)
    unknown = sorted(set(chosen) - set(known))
    if unknown:
        parser.error(f"unknown part '{unknown[0]}', expected one of {', '.join(known)}")
    on, sections = machine(), []
    for name in chosen:
        print(f"{name} …", flush=True)
        sections += known[name]()
        print(docs_page.markdown(("what", "", "ratio"), [row[2:5] for row in rows(sections[-1:])]), flush=True)
    on["load average before and after"] += f", {os.getloadavg()[0]:.1f}"
    print(machine_table(on))
    figures = {"machine": on, "sections": [asdict(section) for section in sections]}
    options.json.write_text(json.dumps(figures, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    if options.write:
        TABLE.write(renewed(TABLE.rows(), rows(sections)) if options.only else rows(sections))
        docs_page.put(docs_page.DOCS / TABLE.page, "machine", machine_table(on))


if __name__ == "__main__":
    main()
