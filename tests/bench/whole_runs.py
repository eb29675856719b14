"""Whole runs as a user starts them: a short config of the demonstrator, its processes and what they leave."""

from __future__ import annotations

import fcntl
import pickle
import re
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import yaml
from tests.cli.in_process import hilbench

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.result import Result
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "bench_configs" / "web_section_step.yaml"
SHORT = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 0.6}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
    {"hold": {"duration_s": 1.2}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]
ENDLESS = [SHORT[0], {"hold": {"duration_s": 1000.0}}]
#: Outcome of a shipped config by its name (the fixture `shipped`).
Shipped = Callable[[str], RunOutcome]


def shipped_run(name: str, folder: Path) -> RunOutcome:
    """Outcome of a shipped config in one process, run by whoever asks first of all that share the folder."""
    kept = folder / f"{name}.pickle"
    with open(folder / f"{name}.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            given = load_with_overrides(SHIPPED.with_name(f"{name}.yaml"), bus=f"embedded:t{uuid.uuid4().hex[:10]}")
            outcome = run_experiment(given, folder, participants=Participants.IN_PROCESS)
            kept.write_bytes(pickle.dumps(outcome))
    made: RunOutcome = pickle.loads(kept.read_bytes())
    return made


def config(folder: Path, **changes: object) -> Path:
    data = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    drives = data["drives"].values()
    nodes = [*drives, *(drive["virtual"] for drive in drives), *data["load_motors"].values(), data["twin"]["node"]]
    for node in nodes:
        node["eds"] = str((SHIPPED.parent / node["eds"]).resolve())
    data["machine"]["web"] |= {"youngs_modulus_Pa": 8.7e9, "thickness_m": 65e-6}
    data["steps"], data["criteria"] = SHORT, []
    data["bus"]["address"] = f"embedded:t{uuid.uuid4().hex[:10]}"
    changes["twin"] = data["twin"] | changes.get("twin", {})
    data |= changes
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


#: What `start` has started in this process of the tests; those that a failed test left are ended (tests/conftest.py).
STARTED: list[subprocess.Popen[str]] = []


def _words(path: Path, options: tuple[str, ...], *, report: bool) -> list[str]:
    """Of a run: a report takes longer than so short a run, and is made where it is looked at."""
    return ["run", str(path), "--out", str(path.parent / "runs"), *([] if report else ["--no-report"]), *options]


def start(path: Path, *options: str, report: bool = False) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hilbench", *_words(path, options, report=report)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    STARTED.append(process)
    return process


def run(path: Path, *options: str) -> tuple[int, str, str]:
    process = start(path, *options)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def run_here(path: Path, *options: str, report: bool = False) -> tuple[int, str, str]:
    """The same without processes: for tests of what a run does, which is the same bits in a third of the time."""
    done = hilbench(*_words(path, options, report=report), "--in-process")
    return done.returncode, done.stdout, done.stderr


def run_folders(path: Path) -> list[Path]:
    folders = path.parent / "runs"
    return sorted(folders.iterdir()) if folders.exists() else []


def _commands() -> Iterator[tuple[int, list[str]]]:
    """Process id and words of every process of this machine."""
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):  # it has ended
                yield int(entry.name), (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")


def processes_of(path: Path) -> list[str]:
    """Command lines of the processes that a run of this config started (children by path, hub by channel)."""
    channel = yaml.safe_load(path.read_text())["bus"]["address"].partition(":")[2]
    return [
        " ".join(words)
        for _, words in _commands()
        if any(str(path.parent) in word or channel in word for word in words)
    ]


def pid_of(path: Path, part: str) -> int:
    """Of a process that a run of this config started: its "hardware" or its "twin"."""
    for pid, words in _commands():
        if any(re.search(rf"\b{part}$", word) for word in words) and any(str(path.parent) in word for word in words):
            return pid
    raise AssertionError(f"no process {part}: {processes_of(path)}")


def gone(path: Path, within_s: float = 15.0) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if not processes_of(path):
            return True
        time.sleep(0.1)
    return False


def frames_by_cycle(trace: Path) -> list[Counter[str]]:
    cycles: list[Counter[str]] = []
    for line in trace.read_text().splitlines():
        frame = line.split()[2]
        if frame == "080#":
            cycles.append(Counter())
        elif cycles:
            cycles[-1][frame] += 1
    return cycles


def wait_for_frames(path: Path, count: int, within_s: float = 60.0) -> Path:
    """The run folder, once its trace has so many lines."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        for folder in run_folders(path):
            trace = folder / "trace.log"
            if trace.exists() and trace.read_bytes().count(b" 080#") >= count:
                return folder
        time.sleep(0.05)
    raise AssertionError("the run did not get so far")


def bus_of(path: Path) -> str:
    return str(yaml.safe_load(path.read_text())["bus"]["address"])


def result_of(folder: Path) -> Result:
    return Result.read(folder / "result.json")


def recover(folder: Path) -> subprocess.CompletedProcess[str]:
    return hilbench("recover", folder)
