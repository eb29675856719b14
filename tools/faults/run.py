"""A run that a fault is made on: its config on a bus of its own, its processes, its end."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from processes import command_lines

from hilbench.results.run_folder import RunFolder

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"
CLI = [sys.executable, "-m", "hilbench"]
AT_SPEED_S = 1.0  # the ramp is over
#: Real time: cycle, E of the web that can be emulated over it, time-outs and periods of heartbeats.
SLOW_CYCLE_S, SOFT_PA = 0.01, 2.0e9
PATIENT = {"cycle_timeout_s": 1.0, "missing_cycles": 50, "supervisor_timeout_s": 2.0}
PATIENT_MASTER = {"heartbeat_ms": 400, "node_heartbeat_ms": 400, "boot_timeout_s": 60.0}
FOREVER: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"duration_s": 1000.0}},
]


@dataclass
class Run:
    """One run with a fault: its config, its process and what it left."""

    work: Path
    address: str
    config: Path
    process: subprocess.Popen[str]
    real_time: bool
    fault_sync: int | None = None
    said: str = ""
    code: int | None = None

    @property
    def at_speed_syncs(self) -> int:
        """SYNCs until the line runs."""
        return round(AT_SPEED_S / (SLOW_CYCLE_S if self.real_time else 0.002))

    @property
    def folder(self) -> RunFolder | None:
        """The run's folder, once it is there."""
        found = sorted((self.work / "runs").glob("*"))
        return RunFolder(found[0]) if found else None

    def syncs(self) -> int:
        """SYNCs in the trace so far."""
        folder = self.folder
        return folder.trace.read_bytes().count(b" 080#") if folder and folder.trace.exists() else 0

    def wait_for_speed(self) -> None:
        """Wait until the line runs, then count from here."""
        deadline_s = time.monotonic() + 90.0
        while self.syncs() < self.at_speed_syncs:
            if self.process.poll() is not None or time.monotonic() > deadline_s:
                raise RuntimeError(f"the run did not get under way: {self.process.communicate()[0]}")
            time.sleep(0.05)
        self.fault_sync = self.syncs()

    def pid_of(self, *words: str) -> int:
        """Process of this run whose command line has these words."""
        wanted = [word.encode() for word in words]
        for pid, line in self._processes():
            if all(word in line for word in wanted):
                return pid
        raise RuntimeError(f"no process {words}")

    def clear(self) -> None:
        """End what the fault has left behind; what the bench started ends with it, unless it was stopped."""
        time.sleep(0.5)
        for pid, _ in self._processes():
            os.kill(pid, signal.SIGKILL)

    def _processes(self) -> Iterator[tuple[int, list[bytes]]]:
        # The hub's command line has the name of an embedded bus alone, and nobody else has that name.
        channel = self.address.removeprefix("embedded:").encode()
        work = str(self.work).encode()
        for pid, line in command_lines():
            ours = any(word.startswith(b"hilbench.") for word in line) and any(channel in word for word in line)
            if ours or any(work in word for word in line):
                yield pid, line

    def end(self, timeout_s: float = 90.0) -> None:
        """Wait for the end of the run."""
        try:
            self.said, _ = self.process.communicate(timeout=timeout_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise RuntimeError(f"did not end: {self.process.communicate()[0][-1500:]}") from None
        self.code = self.process.returncode


@dataclass
class Fault:
    """One row: what is done, and what is expected of it."""

    name: str
    expected: str
    codes: tuple[int, ...]
    words: str
    act: Callable[[Run], None]
    changes: dict[str, Any] = field(default_factory=dict)
    options: tuple[str, ...] = ()
    limit_bytes: int | None = None
    real_time: bool = False
    embedded: bool = False  #: what only the embedded bus can do: lose its hub, disturb frames
    environment: Callable[[], dict[str, str]] = dict  #: of the run's processes


def make_config(work: Path, address: str, changes: dict[str, Any], real_time: bool) -> Path:
    """The shipped bench with short steps on a bus of its own."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data |= shipped_parts()
    data |= {"steps": FOREVER, "criteria": [], "safety": {"cycle_timeout_s": 1.0}}
    if real_time:
        data |= {"pace": "realtime", "cycle_time_s": SLOW_CYCLE_S, "safety": PATIENT, "master": PATIENT_MASTER}
        data["machine"]["web"]["youngs_modulus_Pa"] = SOFT_PA
    else:
        data["master"] = {"boot_timeout_s": 120.0}  # an emulated machine starts slowly
    data |= changes
    data["bus"]["address"] = address
    path = work / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


@contextmanager
def started(fault: Fault, bus: str | None) -> Iterator[Run]:
    """A run of the fault's config, on an embedded bus of its own unless said; nothing of it is left afterwards."""
    with tempfile.TemporaryDirectory(prefix="fault-") as folder:
        work = Path(folder)
        address = bus or f"embedded:f{uuid.uuid4().hex[:10]}"
        config = make_config(work, address, dict(fault.changes), fault.real_time)
        limit = fault.limit_bytes

        def restrict() -> None:
            if limit is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

        command = [*CLI, "run", str(config), "--no-report", "--out", str(work / "runs"), *fault.options]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=restrict,
            env=os.environ | fault.environment(),
        )
        run = Run(work, address, config, process, fault.real_time)
        try:
            yield run
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()
            run.clear()


def shipped_parts() -> dict[str, Any]:
    """The blocks of the shipped config that name EDS files, these with their whole path."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    parts: dict[str, Any] = {key: data[key] for key in ("drives", "load_motors", "twin")}
    drives = parts["drives"].values()
    nodes = [*drives, *(drive["virtual"] for drive in drives), *parts["load_motors"].values(), parts["twin"]["node"]]
    for node in nodes:
        node["eds"] = str((CONFIG.parent / node["eds"]).resolve())
    return parts
