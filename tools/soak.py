"""Soak: hours of simulated operation in lockstep with random faults; what each process holds, over time.

    python tools/soak.py                     an hour, the table on the terminal
    python tools/soak.py --hours 0.1         shorter
    python tools/soak.py --within 45         as far as it gets in so many minutes of wall time
    python tools/soak.py --write             puts the table into docs/fault_tests.md too

Most of the time is one run: disturbed frames, hostile frames of a foreign station, steps of E, changes of the
synchronizer, resets of the twin. What a process holds must not grow there. The rest is many short runs in the same
bench process, each with a fault that ends a process or the run: kill -9, an emergency stop, a web break. What the bench
holds between two runs must not grow there, and no process may be left over. Samples are not recorded: they are kept in
memory on purpose. The exit code is 1 when something grew.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import inf
from pathlib import Path

import docs_page
from processes import command_lines

from hilbench.bench.bench import Bench
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import Frame
from hilbench.can.hub_client import inject_errors
from hilbench.can.open import open_link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP
from hilbench.canopen.identifiers import FUNCTION_CODE, SDO_REQUEST
from hilbench.errors import BenchFaultError
from hilbench.results.trace import TraceWriter
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"
#: Simulated time between two looks at the processes, between two faults of the long run, and of a short run.
LOOK_S, FAULT_S, SHORT_S = 10.0, 4.0, 6.0
#: Part of the time that is one long run.
LONG = 0.8
#: Part of a series at its beginning in which caches fill; growth is looked for behind it.
WARM_UP = 0.25
#: Growth of the memory that a series may show (its last quarter's least value over the first's behind the warm-up).
ALLOWED_KB = 1024
#: No NMT, no SYNC, no emergency stop; COB-IDs of the cyclic answers would be taken for those.
HOSTILE = [0x081, 0x0FF, 0x100, 0x2FF, 0x4FF, 0x5FF, 0x601, 0x602, 0x611, 0x620, 0x6FF, 0x750, 0x7E5, 0x7FF]


@dataclass(frozen=True)
class Held:
    """What a process holds: memory in kB, open file handles, threads.

    Memory is the anonymous part of the PSS: the part of libraries depends on who else has them open.
    """

    memory_kB: int
    handles: int
    threads: int

    @classmethod
    def by(cls, pid: int) -> Held:
        """Raises OSError when the process has ended."""
        folder = Path(f"/proc/{pid}")
        rollup = (folder / "smaps_rollup").read_text()
        memory_kB = int(next(line for line in rollup.splitlines() if line.startswith("Pss_Anon:")).split()[1])
        return cls(memory_kB, len(list((folder / "fd").iterdir())), len(list((folder / "task").iterdir())))


@dataclass
class Series:
    """What one process held over time."""

    name: str
    held: list[Held] = field(default_factory=list)

    def _parts(self, quantity: str) -> tuple[list[int], list[int]]:
        values = [getattr(held, quantity) for held in self.held[int(WARM_UP * len(self.held)) :]]
        quarter = max(1, len(values) // 4)
        return values[:quarter], values[-quarter:]

    def before_and_after(self, quantity: str) -> tuple[int, int]:
        """Least value in the first and the last quarter behind the warm-up: what comes and goes is no leak."""
        first, last = self._parts(quantity)
        return min(first), min(last)

    def grew(self, allowed_kB: int = ALLOWED_KB) -> list[str]:
        """The quantities that grew, the memory by more than is allowed."""
        found = []
        for quantity, allowed in (("memory_kB", allowed_kB), ("handles", 0), ("threads", 0)):
            before, after = self.before_and_after(quantity)
            if after > before + allowed:
                found.append(f"{quantity} of {self.name}: {before} to {after}")
        return found

    def cells(self) -> list[str]:
        """A row of the table."""
        cells = ["{} → {}".format(*self.before_and_after(quantity)) for quantity in ("memory_kB", "handles", "threads")]
        peak = max(held.memory_kB for held in self.held)
        return [self.name, f"{cells[0]} ({peak})", *cells[1:], str(len(self.held))]


def processes_of(channel: str) -> list[int]:
    """Processes but ours that have the channel's name in their command line."""
    wanted = channel.encode()
    return [pid for pid, words in command_lines() if pid != os.getpid() and any(wanted in word for word in words)]


class Soak:
    """The whole time: `hours` simulated, all draws from `seed`."""

    def __init__(self, hours: float, seed: int, within_s: float) -> None:
        now_s = time.monotonic()
        self.long_until_s, self.until_s = now_s + LONG * within_s, now_s + within_s
        self.random = random.Random(seed)
        self.channel = f"soak{os.getpid()}"
        changes = ["safety.cycle_timeout_s=2.0", "safety.limits.estimate_ratio.trip=null"]
        self.config = load_with_overrides(CONFIG, bus=f"embedded:{self.channel}", changes=changes).config
        self.long_s, self.short_s = 3600.0 * hours * LONG, 3600.0 * hours * (1.0 - LONG)
        self.long: dict[str, Series] = {}
        self.between = Series("bench, between two runs")
        self.faults: dict[str, int] = {}
        self.left_over = 0
        self.simulated_s = 0.0

    # -- one long run --------------------------------------------------------------------------------------------------

    def long_run(self, folder: Path) -> None:
        """What is ridden out, over and over."""
        with TraceWriter(folder / "long.log", self.channel) as trace, self._bench(trace, folder) as bench:
            bench.ramp("line_speed_m_s", 2.0, 2.0)
            pids = {"bench": os.getpid()} | {child.name: child.pid for child in bench.children}
            pids |= {_what(pid): pid for pid in processes_of(self.channel) if pid not in pids.values()}
            self.long = {name: Series(name) for name in pids}
            began_s, looked_s = bench.time_s, 0.0
            while bench.time_s - began_s < self.long_s and time.monotonic() < self.long_until_s:
                try:
                    self._ride_out(bench)
                    bench.run(FAULT_S)
                except BenchFaultError as error:
                    last = "; ".join(f"{notice.time_s:.3f} s {notice.text}" for notice in list(bench.notices)[-8:])
                    raise RuntimeError(f"{error}; faults so far: {self.faults}; before: {last}") from error
                if bench.time_s - looked_s >= LOOK_S:
                    looked_s = bench.time_s
                    for name, pid in pids.items():
                        self.long[name].held.append(Held.by(pid))
                    self._say(bench.time_s)
            inject_errors(self.channel, ErrorInjection())
            self.simulated_s += bench.time_s
        (folder / "long.log").unlink()

    def _ride_out(self, bench: Bench) -> None:
        draw = self.random
        acts: list[tuple[str, Callable[[], None]]] = [
            ("step of E", lambda: bench.step("load.web.youngs_modulus_Pa", draw.uniform(7.5e9, 10.5e9))),
            ("another synchronizer", lambda: bench.use_synchronizer(draw.choice(["pid", "rls", "ekf", "changepoint"]))),
            ("reset of the twin", bench.restart_twin),
            ("hostile frames", self._hostile_frames),
            ("disturbed frames", self._disturb),
        ]
        name, act = draw.choice(acts)
        self._count(name)
        act()

    def _disturb(self) -> None:
        share = 10.0 ** self.random.uniform(-3.0, -1.0)
        what = {self.random.choice(["duplicated", "delayed", "corrupted"]): share}
        cyclic = ((0x180, 0x780), (0x200, 0x780), (0x280, 0x780), (0x380, 0x780))
        seed = self.random.randrange(1 << 30)
        inject_errors(self.channel, ErrorInjection(seed=seed, delay_s=0.0003, filters=cyclic, **what))

    def _hostile_frames(self) -> None:
        link = open_link(self.config.bus_address)
        for _ in range(64):
            data = self.random.randbytes(self.random.randrange(9))
            can_id = self.random.choice(HOSTILE)
            if can_id & FUNCTION_CODE == SDO_REQUEST:  # reads only: a random write might, rightly, stop the drive
                data = bytes((0x40,)) + self.random.randbytes(3) + bytes(4)
            link.send([Frame(can_id, data)])
        link.receive(0.01)
        link.close()

    # -- many short ones -----------------------------------------------------------------------------------------------

    def short_runs(self, folder: Path) -> None:
        """What ends a run, or one of its processes."""
        end_s = self.simulated_s + self.short_s
        while self.simulated_s < end_s and time.monotonic() < self.until_s:
            name = self.random.choice(["kill twin", "kill hardware", "kill hub", "emergency stop", "web break", "none"])
            with TraceWriter(folder / "short.log", self.channel) as trace:
                bench = self._bench(trace, folder)
                try:
                    with bench:
                        bench.ramp("line_speed_m_s", 1.0, 0.5)
                        bench.run(self.random.uniform(0.5, SHORT_S))
                        self._end_something(bench, name)
                        bench.run(2.0)
                except BenchFaultError as error:
                    if name in ("none", "kill twin"):
                        raise RuntimeError(f"{name}: {error}") from error
                self.simulated_s += bench.time_s
            (folder / "short.log").unlink()
            self._count(name)
            self._wait_for_end()
            self.between.held.append(Held.by(os.getpid()))
            self._say(self.simulated_s)

    def _end_something(self, bench: Bench, name: str) -> None:
        children = {child.name: child.pid for child in bench.children}
        if name == "kill twin":
            os.kill(children["twin"], signal.SIGKILL)
        elif name == "kill hardware":
            os.kill(children["simulated hardware"], signal.SIGKILL)
        elif name == "kill hub":
            os.kill(next(pid for pid in processes_of(self.channel) if _what(pid) == "hub"), signal.SIGKILL)
        elif name == "emergency stop":
            link = open_link(self.config.bus_address)
            link.send(EMERGENCY_STOP)
            link.receive(0.01)
            link.close()
        elif name == "web break":
            bench.set("load.web.broken", 1.0)

    def _wait_for_end(self) -> None:
        deadline_s = time.monotonic() + 10.0
        while processes_of(self.channel) and time.monotonic() < deadline_s:
            time.sleep(0.05)
        self.left_over = max(self.left_over, len(processes_of(self.channel)))

    # -- both ----------------------------------------------------------------------------------------------------------

    def _bench(self, trace: TraceWriter, folder: Path) -> Bench:
        return Bench(self.config, tap=trace, work_folder=folder)

    def _count(self, name: str) -> None:
        self.faults[name] = self.faults.get(name, 0) + 1

    def _say(self, at_s: float) -> None:
        held = Held.by(os.getpid())
        print(f"{at_s:.0f} s: {sum(self.faults.values())} faults, bench {held}", file=sys.stderr, flush=True)

    def series(self) -> Iterator[Series]:
        """All of them."""
        yield from self.long.values()
        if self.between.held:
            yield self.between

    def problems(self) -> list[str]:
        """What grew, or was left over."""
        found = [text for series in self.series() for text in series.grew()]
        return [*found, f"{self.left_over} processes left over"] if self.left_over else found

    def page(self, wall_s: float) -> str:
        """What was done, and what came of it."""
        faults = ", ".join(f"{count} × {name}" for name, count in sorted(self.faults.items()))
        last = f"{self.left_over} processes left over. " + ("; ".join(self.problems()) or "Nothing grew.")
        about = f"{self.simulated_s / 60.0:.0f} min simulated, in {wall_s / 60.0:.0f} min: {faults}."
        return f"{about} {last}"


def _what(pid: int) -> str:
    words = Path(f"/proc/{pid}/cmdline").read_bytes()
    return "hub" if b"hilbench.can.hub" in words else "supervisor"


def summary(rows: list[docs_page.Row]) -> str:
    """Memory of each process."""
    return "Memory in kB: " + "; ".join(f"{row['process']} {row['memory, kB (most)']}" for row in rows) + "."


TABLE = docs_page.Table(
    "soak_processes",
    "fault_tests.md",
    ("process", "memory, kB (most)", "file handles", "threads", "looks"),
    summary,
)


def main() -> int:
    """Soak, print, and put the table into the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0, help="simulated time")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="write the table into docs/fault_tests.md")
    parser.add_argument("--within", type=float, default=inf, metavar="MIN", help="end after so much wall time")
    options = parser.parse_args()
    began_s = time.monotonic()
    soak = Soak(options.hours, options.seed, 60.0 * options.within)
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        # A bus of its own: `hilbench estop` without an address stops every bus of the user.
        os.environ["XDG_RUNTIME_DIR"] = folder
        soak.long_run(Path(folder))
        soak.short_runs(Path(folder))
    text = soak.page(time.monotonic() - began_s)
    rows = [series.cells() for series in soak.series()]
    print(text, docs_page.markdown(TABLE.columns, rows), sep="\n\n")
    if options.write:
        docs_page.put(docs_page.DOCS / TABLE.page, "soak", text)
        TABLE.write(rows)
    return 1 if soak.problems() else 0


if __name__ == "__main__":
    sys.exit(main())
