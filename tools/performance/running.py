"""The bench without a clock: lockstep speed, and how long the commands take to start."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import lockstep_profile

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides
from performance.table import Section, best_s

_HILBENCH = str(Path(sys.executable).with_name("hilbench"))
_POLL_S = 0.02
_SYNC = re.compile(r"^\((\S+)\) \S+ 080#$", re.MULTILINE)
_LONGEST_START_S = 240.0


def lockstep(config_path: Path, seconds: float) -> Section:
    """Where the time of a cycle goes, and how much faster than real time the demo runs."""
    section = Section(
        "Lockstep, the demo",
        f"{seconds:g} s of experiment time, all processes, all frames on the embedded bus, trace on; "
        "then the same in one process.",
    )
    with tempfile.TemporaryDirectory() as folder:
        figures = lockstep_profile.measure(config_path, seconds, Path(folder))
        alone = lockstep_profile.measure(config_path, seconds, Path(folder), Participants.IN_PROCESS)
    factor = figures.pop("real-time factor")
    section.add("speed", factor, "× real time")
    in_process = alone["real-time factor"]
    section.add("speed with --in-process", in_process, "× real time", in_process / factor, "processes")
    section.add("CPU of --in-process", alone["CPU of bench"], "µs per cycle")
    wall = figures["wall time"]
    for name, value in figures.items():
        section.add(name, value, "µs per cycle", value / wall, "wall time")
    return section


def machines(configs: Sequence[Path]) -> Section:
    """How the cost of a cycle grows with rollers, spans and nodes, and with what no motor drives."""
    section = Section(
        "Other machines, in one process",
        "Whole runs of configs of `bench_configs/` as their steps have them, from the first SYNC to the last, trace, "
        "recording and criteria included: bus time over wall time, and wall time of a cycle beside that of the first. "
        "In parentheses spans of web, axes and load motors.",
    )
    first = None
    with tempfile.TemporaryDirectory() as folder:
        for path in configs:
            loaded = load_with_overrides(path, seed=1)
            config = loaded.config
            timing = run_experiment(loaded, Path(folder), participants=Participants.IN_PROCESS).result.timing
            assert timing.realtime_factor is not None
            cycle_us = config.cycle_time_s * 1e6 / timing.realtime_factor
            first = first or cycle_us
            shape = config.shape
            name = f"{path.stem} ({shape.spans}, {shape.axes}, {len(shape.load_motors)})"
            section.add(name, timing.realtime_factor, "× real time", cycle_us / first, "a cycle of the first")
    return section


def start_up(config_path: Path) -> Section:
    """`--help`, and `run` until its first SYNC: with machine code on disk, and without."""
    section = Section(
        "Start-up",
        "Wall time from the start of the process. First SYNC: by its time stamp in the trace. `hilbench compile`, as "
        "`make test` runs it: everything is compiled anew. Cold: the first run after that.",
    )
    bare = best_s(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True), 5)
    shown = best_s(lambda: subprocess.run([_HILBENCH, "--help"], check=True, capture_output=True), 5)
    section.add("python -c pass", bare, "s")
    section.add("hilbench --help", shown, "s", shown / bare, "python -c pass")
    _first_sync_s(config_path, {})
    warm = min(_first_sync_s(config_path, {}) for _ in range(2))
    section.add("hilbench run to first SYNC, warm", warm, "s", warm / bare, "python -c pass")
    with tempfile.TemporaryDirectory() as cache:
        kept = {"NUMBA_CACHE_DIR": cache}
        compiling = best_s(
            lambda: subprocess.run([_HILBENCH, "compile"], env=os.environ | kept, check=True, capture_output=True), 1
        )
        cold = _first_sync_s(config_path, kept)
    section.add("hilbench compile", compiling, "s")
    section.add("hilbench run to first SYNC, cold", cold, "s", cold / warm, "warm")
    return section


def _first_sync_s(config_path: Path, environment: dict[str, str]) -> float:
    """Start a run, find the first SYNC in its trace, interrupt it."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.time()
        command = [_HILBENCH, "run", str(config_path), "--bus", f"embedded:start{os.getpid()}", "--out", folder]
        process = subprocess.Popen(
            command, env=os.environ | environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            while time.time() - start < _LONGEST_START_S and process.poll() is None:
                for trace in Path(folder).glob("*/trace.log"):
                    sync = _SYNC.search(trace.read_text())
                    if sync:
                        return float(sync[1]) - start
                time.sleep(_POLL_S)
        finally:
            process.send_signal(signal.SIGINT)
            process.wait()
    raise RuntimeError(f"no SYNC, ended with {process.returncode}: {' '.join(command)}")
