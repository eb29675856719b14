"""How fast a config runs in lockstep and where a cycle's time goes.

    lockstep_profile.py [CONFIG] [--in-process] [--json]

The bench's own time is split at the last answer; before it the bench waits, and counts and traces what it has. CPU time
is what the scheduler says that the threads of each process have run, divided by the cycles in between.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path

from processes import command_lines
from rich.console import Console
from rich.table import Table

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording_builder import Recorder
from hilbench.results.trace import TraceWriter
from hilbench.runs.config import load_with_overrides

#: Experiment time after which a hub that forwards has loaded what it needs for that.
_UNDER_WAY_S = 6.0
_SCHEDULED = 2  # CPUCLOCK_SCHED of <linux/posix-timers.h>


def cpu_s(pid: int) -> float:
    """CPU time of a process so far, its ended threads as well. That of `stat` is sampled at ticks, which cycles fall in
    step with; this is the process's own clock (clock_getcpuclockid(3))."""
    return time.clock_gettime(~pid << 3 | _SCHEDULED)


def hub_pid(channel: str) -> int | None:
    """The process that serves an embedded bus."""
    found = (pid for pid, words in command_lines() if b"hilbench.can.hub" in words and channel.encode() in words)
    return next(found, None)


def pids_of(bench: Bench) -> dict[str, int]:
    """The processes of a bench that runs, by name."""
    pids = {"bench": os.getpid()} | {child.name: child.pid for child in bench.children}
    hub = hub_pid(bench.config.bus_address.channel) if bench.children else None
    return pids if hub is None else pids | {"hub": hub}


def measure(
    config_path: Path, seconds: float, folder: Path, participants: Participants = Participants.STARTED
) -> dict[str, float]:
    """Run the bench at 3 m/s for so much experiment time; µs per cycle of each part, and the real-time factor."""
    config = load_with_overrides(config_path, bus=f"embedded:profile{os.getpid()}", pace="lockstep").config
    recorder = Recorder(config.signals)
    with (
        TraceWriter(folder / f"trace-{os.getpid()}-{participants.name}.log", "profile") as trace,
        Bench(config, observers=[recorder], tap=trace, participants=participants) as bench,
    ):
        bench.ramp("line_speed_m_s", 3.0, 1.0)
        bench.run(_UNDER_WAY_S)
        timing = bench.exchange.timing if bench.exchange else None
        assert timing is not None
        pids = pids_of(bench)
        cpu = {name: cpu_s(pid) for name, pid in pids.items()}
        cycles, wait_ns, wall_ns = timing.cycles, timing.wait_ns, time.monotonic_ns()
        bench.run(seconds)
        cycles = timing.cycles - cycles
        wall_us = (time.monotonic_ns() - wall_ns) / 1e3 / cycles
        wait_us = (timing.wait_ns - wait_ns) / 1e3 / cycles
        figures = {
            "real-time factor": config.cycle_time_s * 1e6 / wall_us,
            "wall time": wall_us,
            "bench from SYNC to the last answer": wait_us,
            "bench from there to the next SYNC": wall_us - wait_us,
        }
        for name, pid in pids.items():
            figures[f"CPU of {name}"] = (cpu_s(pid) - cpu[name]) * 1e6 / cycles
    return figures


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", nargs="?", type=Path, default=Path("bench_configs/web_section_step.yaml"))
    parser.add_argument("--seconds", type=float, default=20.0, help="experiment time to measure over")
    parser.add_argument("--in-process", action="store_true", help="simulated hardware and twin in the bench's process")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("/tmp"), help="folder for the trace that is written meanwhile")
    options = parser.parse_args()
    participants = Participants.IN_PROCESS if options.in_process else Participants.STARTED
    figures = measure(options.config, options.seconds, options.out, participants)
    if options.json:
        print(json.dumps(figures, indent=2))
        return
    table = Table(title=f"{options.config.name}, lockstep", title_justify="left")
    table.add_column("what")
    table.add_column("µs per cycle", justify="right")
    for name, value in figures.items():
        table.add_row(name, f"{value:.2f} x" if name == "real-time factor" else f"{value:.0f}")
    Console().print(table)


if __name__ == "__main__":
    main()
