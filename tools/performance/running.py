"""The running bench: lockstep speed, SYNC jitter beside a bare timer loop, and how long the commands take to start."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import lockstep_profile
import numpy as np

from hilbench.bench.bench import Bench
from hilbench.bench.participants import Participants
from hilbench.errors import BenchFaultError
from hilbench.experiment.config import load_with_overrides
from performance.table import Section, best_s

_HILBENCH = str(Path(sys.executable).with_name("hilbench"))
_POLL_S = 0.02
_SYNC = re.compile(r"^\((\S+)\) \S+ 080#$", re.MULTILINE)
_LONGEST_START_S = 240.0
_PATIENCE_CYCLES = 10_000
#: A loop that does nothing but wait for absolute deadlines, as the bench does: what the machine allows.
_BARE_LOOP = """
import json, sys
from hilbench.bench import pacing
from time import monotonic_ns
state = pacing.Pacing(period_ns=int(sys.argv[1]))
pacing.start(state, monotonic_ns())
for _ in range(int(sys.argv[2])):
    pacing.advance(state, pacing.sleep_until(state.deadline_ns))
print(json.dumps([state.lateness_ns, state.missed]))
"""


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


def jitter(config_path: Path, seconds: float) -> Section:
    """Lateness of SYNC in real time, the bare loop before and behind it."""
    section = Section(
        "Real time, lateness of SYNC",
        f"{seconds:g} s of the bench of the demo, enabled, at standstill; a bare loop on the same deadlines half of "
        "that time before and half behind. Missed: cycles late by a whole period.",
    )
    config = load_with_overrides(config_path, bus=f"embedded:jitter{os.getpid()}", pace="realtime").config
    # On a machine that others use as well answers stay away; what is measured here is when SYNC goes out.
    patient = config.safety.model_copy(update={"missing_cycles": _PATIENCE_CYCLES})
    config = config.model_copy(update={"safety": patient})
    cycle_ns = round(config.cycle_time_s * 1e9)
    cycles = round(seconds * 1e9) // cycle_ns
    bare, bare_missed = _bare(cycle_ns, cycles // 2)
    fault = None
    try:
        with Bench(config) as bench:
            bench.run(1.0)
            assert bench.exchange is not None
            pacing = bench.exchange.pacing
            first, missed_before = len(pacing.lateness_ns), pacing.missed
            bench.run(seconds)
    except BenchFaultError as error:  # too little of the processor is left: the figures until then say how little
        fault = error
    lateness, missed = np.array(pacing.lateness_ns[first:]) / 1e3, pacing.missed - missed_before
    behind, behind_missed = _bare(cycle_ns, cycles - cycles // 2)
    floor = np.concatenate([bare, behind])
    for name, share in (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9)):
        least, ours = float(np.percentile(floor, share)), float(np.percentile(lateness, share))
        section.add(f"bare loop, {name}", least, "µs")
        section.add(f"bench, {name}", ours, "µs", ours / least, "bare loop")
    section.add("bare loop, missed", bare_missed + behind_missed, f"of {cycles} cycles")
    section.add("bench, missed", missed, f"of {len(lateness)} cycles")
    if fault is not None:
        section.how += f" The run ended early: {fault}."
    return section


def _bare(cycle_ns: int, cycles: int) -> tuple[np.ndarray, int]:
    command = [sys.executable, "-c", _BARE_LOOP, str(cycle_ns), str(cycles)]
    lateness, missed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return np.array(lateness) / 1e3, int(missed)


def start_up(config_path: Path) -> Section:
    """`--help`, and `run` until its first SYNC: with machine code on disk, and without."""
    section = Section(
        "Start-up",
        "Wall time from the start of the process. First SYNC: by its time stamp in the trace. Cold: everything that is "
        "compiled is compiled anew, by each process for itself.",
    )
    bare = best_s(lambda: subprocess.run([sys.executable, "-c", "pass"], check=True), 5)
    shown = best_s(lambda: subprocess.run([_HILBENCH, "--help"], check=True, capture_output=True), 5)
    section.add("python -c pass", bare, "s")
    section.add("hilbench --help", shown, "s", shown / bare, "python -c pass")
    _first_sync_s(config_path, {})
    warm = min(_first_sync_s(config_path, {}) for _ in range(2))
    section.add("hilbench run to first SYNC, warm", warm, "s", warm / bare, "python -c pass")
    with tempfile.TemporaryDirectory() as cache:
        try:
            cold = _first_sync_s(config_path, {"NUMBA_CACHE_DIR": cache})
        except RuntimeError:  # too little of the processor is left; the other figures stand
            section.how += f" The cold start did not get there within {_LONGEST_START_S:g} s."
            return section
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
