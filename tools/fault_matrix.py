"""The fault matrix: every fault is made on a real run (real processes, a real bus), and its outcome is tabulated.

    python tools/fault_matrix.py                 print the table
    python tools/fault_matrix.py --write         write it into docs/faults.md too
    python tools/fault_matrix.py --only twin     only the faults with this in their name
    python tools/fault_matrix.py --only kill --bus socketcan:vcan0      on another bus; faults of the hub are left out

A row passes when the run ended with the expected exit code and said the expected words. "To safe state" counts cycles
from the fault until every drive shows by its statusword (PDO, or SDO after an emergency stop) that it stands or has no
power. "Kept" are the samples of the recording, recovered from the trace where the run was cut off.

Rows in real time run with cycles of 10 ms, the time-outs of a slow bench and a softer web (the load motor can't imitate
a stiff one over such a cycle): what is tested is the fault, not this machine. A row that fails while more than 2 % of
the cycles were missed is made again, up to three times; when it still does, it is marked "busy". Exit code 1 when a row
does not pass.
"""

from __future__ import annotations

import argparse
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from hilbench.bus.disturbance import ErrorInjection
from hilbench.bus.frame import Frame
from hilbench.bus.hub_client import inject_errors
from hilbench.bus.open import BusAddress, open_link
from hilbench.drives.state_machine import POWERED, STATUS_TARGET_REACHED, State, decode_statusword
from hilbench.errors import HilbenchError
from hilbench.record.recording import read_recording
from hilbench.record.result import Result
from hilbench.record.run_folder import RunFolder
from hilbench.record.trace import TraceReader

ROOT = Path(__file__).resolve().parents[1]
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"
PAGE = ROOT / "docs" / "faults.md"
BEGIN, END = "<!-- table: begin -->", "<!-- table: end -->"
CLI = [sys.executable, "-m", "hilbench.cli"]
AT_SPEED_S = 1.0  # the ramp is over
#: Real time: cycle, E of the web that can be imitated over it, time-outs and periods of heartbeats.
SLOW_CYCLE_S, SOFT_PA = 0.01, 2.0e9
PATIENT = {"cycle_timeout_s": 1.0, "missing_cycles": 50, "supervisor_timeout_s": 2.0}
PATIENT_MASTER = {"heartbeat_ms": 400, "node_heartbeat_ms": 400, "boot_timeout_s": 60.0}
#: Share of missed cycles from which a machine is too busy for a verdict, and how often a row is tried.
BUSY, TRIES = 0.02, 3
DRIVES = (1, 2, 3)
QUICK_STOP = b"\x02\x00"
FOREVER: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"duration_s": 1000.0}},
]
#: Controlwords: fault reset, shutdown, switch on, enable operation.
RESET_AND_ENABLE = (0x80, 0x06, 0x07, 0x0F)
#: clock_gettime, gettimeofday and time of the C library, CLOCK_REALTIME off by the int64 ns in a file.
SETTABLE_CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
static volatile long long *offset;
static int (*real)(clockid_t, struct timespec *);
__attribute__((constructor)) static void begin(void) {
    int file = open(getenv("CLOCK_OFFSET_FILE"), O_RDONLY | O_CLOEXEC);
    real = dlsym(RTLD_NEXT, "clock_gettime");
    offset = mmap(0, 8, PROT_READ, MAP_SHARED, file, 0);
}
int clock_gettime(clockid_t id, struct timespec *t) {
    int result = real(id, t);
    if (id == CLOCK_REALTIME && offset) {
        long long ns = t->tv_sec * 1000000000LL + t->tv_nsec + *offset;
        t->tv_sec = ns / 1000000000LL, t->tv_nsec = ns % 1000000000LL;
    }
    return result;
}
int gettimeofday(struct timeval *v, void *zone) {
    struct timespec t;
    int result = clock_gettime(CLOCK_REALTIME, &t);
    v->tv_sec = t.tv_sec, v->tv_usec = t.tv_nsec / 1000;
    return result;
}
time_t time(time_t *t) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (t) *t = now.tv_sec;
    return now.tv_sec;
}
"""
LONG: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 8.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]
SHORT: list[dict[str, Any]] = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 3.0}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
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
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    line = (entry / "cmdline").read_bytes().split(b"\0")
                except OSError:
                    continue
                ours = any(word.startswith(b"hilbench.") for word in line) and any(channel in word for word in line)
                if ours or any(work in word for word in line):
                    yield int(entry.name), line

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
    environment: dict[str, str] = field(default_factory=dict)


@dataclass
class Row:
    """What came of it."""

    fault: Fault
    code: int | None
    passed: bool
    cycles: int | None
    kept: str
    said: str
    busy: bool = False  #: the machine missed so many cycles that a failure says nothing


def make_config(work: Path, address: str, changes: dict[str, Any], real_time: bool) -> Path:
    """The shipped bench with short steps on a bus of its own."""
    data = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))
    data["nodes"] = _shipped_nodes()
    data |= {"steps": FOREVER, "criteria": [], "safety": {"cycle_timeout_s": 1.0}}
    if real_time:
        data |= {"pace": "realtime", "cycle_time_s": SLOW_CYCLE_S, "safety": PATIENT, "master": PATIENT_MASTER}
        data["model"]["web"]["youngs_modulus_Pa"] = SOFT_PA
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

        command = [*CLI, "run", str(config), "--out", str(work / "runs"), *fault.options]
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=restrict,
            env=os.environ | fault.environment,
        )
        run = Run(work, address, config, process, fault.real_time)
        try:
            yield run
        finally:
            if process.poll() is None:
                process.kill()
                process.communicate()
            run.clear()


def stopped_after(run: Run) -> int | None:
    """Cycles from the fault until all drives show that they have stopped; None when the trace does not show it.

    A fault that the run makes itself (a trip, a break) counts from the first controlword that says quick stop.
    """
    folder, since = run.folder, run.fault_sync
    if folder is None or not folder.trace.exists():
        return None
    sync, states = 0, dict.fromkeys(DRIVES, False)
    for can_id, data, _ in TraceReader(folder.trace):
        if can_id == 0x080:
            sync += 1
        elif can_id == 0x201 and data[:2] == QUICK_STOP and since is None:
            since = sync
        elif can_id - 0x180 in states and len(data) == 8:
            states[can_id - 0x180] = _stands(int.from_bytes(data[:2], "little"))
        elif can_id - 0x580 in states and data[1:3] == b"\x41\x60":
            states[can_id - 0x580] = _stands(int.from_bytes(data[4:6], "little"))
        if since is not None and sync > since and all(states.values()):
            return sync - since
    return None


def _stands(statusword: int) -> bool:
    state = decode_statusword(statusword)
    if state is State.QUICK_STOP_ACTIVE:
        return bool(statusword & STATUS_TARGET_REACHED)
    return state not in POWERED


def kept(run: Run) -> str:
    """How much of the data is there after the run, or after `hilbench recover`."""
    folder = run.folder
    if folder is None:
        return "nothing was started"
    how = ""
    if not folder.recording.exists() and run.syncs() > run.at_speed_syncs:
        done = subprocess.run([*CLI, "recover", str(folder.path)], capture_output=True, text=True, check=False)
        how = ", recovered" if done.returncode == 0 else f", {done.stderr.strip()}"
    if not folder.recording.exists():
        return "trace" + how
    return f"{len(read_recording(folder.recording))} of {run.syncs()} cycles{how}"


def carry_out(fault: Fault, bus: str | None) -> Row:
    """Make the fault, again when the machine was too busy for it."""
    for _ in range(TRIES):
        row = _once(fault, bus)
        if row.passed or not row.busy:
            break
    return row


def _once(fault: Fault, bus: str | None) -> Row:
    """Make the fault and look at what came of it."""
    with started(fault, bus) as run:
        try:
            fault.act(run)
            run.end()
        except (RuntimeError, HilbenchError, subprocess.CalledProcessError) as error:
            said = f"{type(error).__name__}: {error}"
            return Row(fault, run.code, False, None, "", said, busy=_busy(run))
        text = " ".join(run.said.split())
        folder = run.folder
        if folder is not None and folder.result.exists():
            result = Result.read(folder.result)
            told = [fault.text for fault in result.faults] + result.all_warnings()
            text = " | ".join(told) or text
        cycles = stopped_after(run) if run.code in (3, 130) else None
        passed = run.code in fault.codes and fault.words in text
        return Row(fault, run.code, passed, cycles, kept(run), text, busy=_busy(run))


def _busy(run: Run) -> bool:
    folder = run.folder
    if not run.real_time or folder is None or not folder.result.exists():
        return run.real_time
    timing = Result.read(folder.result).timing
    return timing.cycles == 0 or timing.missed > BUSY * timing.cycles


# -- what is done to a run ---------------------------------------------------------------------------------------------


def send_signal(number: int, *words: str) -> Callable[[Run], None]:
    """Send a signal to one of the run's processes once the line runs; no words: the bench."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        os.kill(run.pid_of(*words) if words else run.process.pid, number)

    return act


def hold_up(duration_s: float, *words: str) -> Callable[[Run], None]:
    """SIGSTOP, and SIGCONT after a while."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        pid = run.pid_of(*words) if words else run.process.pid
        os.kill(pid, signal.SIGSTOP)
        time.sleep(duration_s)
        os.kill(pid, signal.SIGCONT)

    return act


def say(*frames: Frame, times: int = 1) -> Callable[[Run], None]:
    """Let a foreign station send frames once the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        link = open_link(bus_of(run))
        try:
            for _ in range(times):
                link.send(frames)
            link.receive(0.05)
        finally:
            link.close()

    return act


def bus_of(run: Run) -> BusAddress:
    """The bus of the run as it runs."""
    return BusAddress.parse(run.address, timing="real" if run.real_time else "virtual")


def babble(duration_s: float) -> Callable[[Run], None]:
    """A node that sends the identifier that wins every arbitration but NMT's, as fast as the wire takes it."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        link = open_link(bus_of(run))
        link.set_filters([(0x7FF, 0x7FF)])
        end_s = time.monotonic() + duration_s
        try:
            while time.monotonic() < end_s and run.process.poll() is None:
                link.send([Frame(0x010, bytes(8))] * 16)
        finally:
            link.close()

    return act


def disturb(injection: ErrorInjection) -> Callable[[Run], None]:
    """Disturb the cyclic frames from when the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        inject_errors(run.address.partition(":")[2], injection)

    return act


def twin_bus_off(run: Run) -> None:
    """The twin's controller leaves the bus; the disturbance is over before its process is there again."""
    run.wait_for_speed()
    channel = run.address.partition(":")[2]
    inject_errors(channel, ErrorInjection(corrupted=1.0, filters=((0x1A0, 0x7FF),)))
    time.sleep(0.5)
    inject_errors(channel, ErrorInjection())


def settable_clock() -> dict[str, str]:
    """Environment in which CLOCK_REALTIME is off by what stands in a file, for every process of a run.

    It stays off for the runs after it, which makes no difference to them either.
    """
    library = Path(os.environ["XDG_RUNTIME_DIR"]) / "clock.so"
    if not library.exists():
        source = library.with_suffix(".c")
        source.write_text(SETTABLE_CLOCK, encoding="ascii")
        subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"], check=True)
        library.with_name("clock").write_bytes(bytes(8))
    return {"LD_PRELOAD": str(library), "CLOCK_OFFSET_FILE": str(library.with_name("clock"))}


def jump(seconds: float) -> Callable[[Run], None]:
    """Set the clock once the line runs."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        with Path(settable_clock()["CLOCK_OFFSET_FILE"]).open("r+b") as file:  # in place: it is mapped
            file.write(int(seconds * 1e9).to_bytes(8, "little", signed=True))

    return act


def second_hardware(run: Run) -> None:
    """A second set of drives with the same node-IDs on the bus."""
    twice = subprocess.Popen(
        [*CLI, "simulate-hardware", str(run.config)], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )

    def end_with_run() -> None:
        run.process.wait()
        twice.terminate()

    threading.Thread(target=end_with_run, daemon=True).start()


def other_devices(run: Run) -> None:
    """The devices are those of the shipped config, not those that the run's EDS files describe."""
    data = yaml.safe_load(run.config.read_text(encoding="utf-8"))
    data["nodes"] = _shipped_nodes()
    config = run.work / "devices.yaml"
    config.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    for command in ("simulate-hardware", "twin"):
        subprocess.Popen([*CLI, command, str(config)], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def nothing(run: Run) -> None:
    """The fault is in the config."""


def emergency_stop(run: Run) -> None:
    """From another terminal."""
    run.wait_for_speed()
    subprocess.run([*CLI, "estop", "--bus", run.address], check=True, capture_output=True)


def wrong_eds() -> dict[str, Any]:
    """The nodes, axis 1 with the EDS of another product (1018h:2)."""
    nodes = _shipped_nodes()
    text = Path(nodes["axis1"]["eds"]).read_text(encoding="utf-8")
    at = text.index("DefaultValue", text.index("[1018sub2]"))
    path = Path(tempfile.gettempdir()) / f"wrong-{os.getpid()}.eds"
    path.write_text(text[:at] + "DefaultValue=0x12345678" + text[text.index("\n", at) :], encoding="utf-8")
    nodes["axis1"]["eds"] = str(path)
    return {"nodes": nodes}


STOPPED = "quick stop, exit 3"


def faults() -> list[Fault]:
    """All rows."""
    kill, stop = signal.SIGKILL, signal.SIGSTOP
    pre_operational, reset = Frame(0, bytes((128, 1))), Frame(0, bytes((129, 1)))
    return [
        Fault("bench: kill -9", "supervisor and drives stop, data recovered", (-9,), "", send_signal(kill)),
        Fault(
            "bench: SIGSTOP",
            "supervisor sends the emergency stop, exit 3 when it goes on",
            (3,),
            "emergency stop (COB-ID 001h)",
            hold_up(4.0),
        ),
        Fault("bench: Ctrl-C", "quick stop, exit 130", (130,), "interrupted", send_signal(signal.SIGINT)),
        Fault(
            "twin: kill -9",
            "loop opens, process started again, loop closes",
            (0,),
            "tension loop closed again",
            send_signal(kill, "twin"),
            {"steps": _with_loop_back()},
        ),
        Fault(
            "twin: SIGSTOP for 3 s",
            "loop opens, twin taken back, loop closes",
            (0,),
            "tension loop closed again",
            hold_up(3.0, "twin"),
            {"steps": _with_loop_back()},
        ),
        Fault(
            "hardware: kill -9",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC",
            send_signal(kill, "simulate-hardware"),
        ),
        Fault(
            "hardware: SIGSTOP",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC",
            send_signal(stop, "simulate-hardware"),
        ),
        Fault("supervisor: kill -9", STOPPED, (3,), "supervisor ended", send_signal(kill, "hilbench.bench.supervisor")),
        Fault(
            "hub: kill -9", "exit 3, bus lost; drives stop by 1016h", (3,), "hub", send_signal(kill, "hilbench.bus.hub")
        ),
        Fault("hub: SIGSTOP", "exit 3, nobody answers", (3,), "no answer", send_signal(stop, "hilbench.bus.hub")),
        Fault("emergency stop from a terminal", "drives stop at once, exit 3", (3,), "emergency stop", emergency_stop),
        Fault("drive to PRE-OPERATIONAL (NMT)", STOPPED, (3,), "axis", say(pre_operational)),
        Fault("drive power-cycled (boot-up)", STOPPED, (3,), "axis", say(reset)),
        Fault("drive: fault by itself", STOPPED, (3,), "FAULT", say(_download(1, 0x2001, 0x5441, 2))),
        Fault(
            "trip: speed",
            STOPPED,
            (3,),
            "beyond its trip level",
            nothing,
            {
                "steps": [
                    *FOREVER[:1],
                    {"hold": {"until_s": 1.5}},
                    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
                ],
                "safety": {"cycle_timeout_s": 1.0, "limits": {"speed_m_s": {"trip": 1.2}}},
            },
        ),
        Fault(
            "web break",
            "EMCY FF15h, quick stop, exit 3",
            (3,),
            "web break",
            nothing,
            {
                "steps": [
                    *FOREVER[:1],
                    {"hold": {"until_s": 1.5}},
                    {"step": {"path": "load.web.broken", "to": 1}},
                    FOREVER[1],
                ]
            },
        ),
        Fault(
            "wrong EDS: another product",
            "exit 3 before anything moves",
            (3,),
            "1018h",
            other_devices,
            wrong_eds(),
            ("--no-start",),
        ),
        Fault("two nodes with one id in the config", "exit 2, both named", (2,), "both have", nothing, _same_id()),
        Fault("two devices with one id on the bus", "exit 3", (3,), "", second_hardware),
        Fault(
            "babbling node, 1 s, real time",
            "exit 3 or ridden out, counted",
            (0, 3),
            "",
            babble(1.0),
            {"steps": SHORT},
            real_time=True,
        ),
        *_disturbances(),
        Fault(
            "bench bus off",
            "exit 3, reported; drives stop by themselves",
            (3,),
            "bus off",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x201, 0x7FF),))),
        ),
        Fault(
            "bench bus off, real time",
            "exit 3, reported; drives stop by themselves",
            (3,),
            "bus off",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x201, 0x7FF),))),
            real_time=True,
        ),
        Fault(
            "drives bus off",
            "exit 3, nobody answers",
            (3,),
            "no answer to SYNC from axis1",
            disturb(ErrorInjection(corrupted=1.0, filters=((0x181, 0x7FF),))),
        ),
        Fault(
            "twin bus off",
            "loop opens, process started again, loop closes",
            (0,),
            "tension loop closed again",
            twin_bus_off,
            {"steps": _with_loop_back()},
        ),
        *(
            Fault(
                f"clock set {'forth' if hours > 0 else 'back'} by an hour, {pace}",
                "no difference",
                (0,),
                "",
                jump(hours * 3600.0),
                {"steps": SHORT if pace == "real time" else LONG},
                real_time=pace == "real time",
                environment=settable_clock(),
            )
            for hours in (1, -1)
            for pace in ("lockstep", "real time")
        ),
        *(
            Fault(f"{what}: kill -9, real time", expected, (3,), words, send_signal(kill, command), real_time=True)
            for what, command, expected, words in (
                ("hardware", "simulate-hardware", "exit 3, nobody answers", "no answer to SYNC"),
                ("supervisor", "hilbench.bench.supervisor", STOPPED, "supervisor ended"),
                ("hub", "hilbench.bus.hub", "exit 3, bus lost; drives stop by 1016h", "hub"),
            )
        ),
        Fault(
            "bench: SIGSTOP, real time",
            "supervisor sends the emergency stop, exit 3 when it goes on",
            (3,),
            "emergency stop (COB-ID 001h)",
            hold_up(5.0),
            real_time=True,
        ),
        Fault(
            "drive: EMCY, and goes on",
            "noted, goes on",
            (0,),
            "EMCY 2310h: current",
            say(Frame(0x081, bytes.fromhex("1023030000000000"))),
            {"steps": LONG},
        ),
        Fault("drive: heartbeat stops", STOPPED, (3,), "has sent no heartbeat", say(_download(1, 0x1017, 0, 2))),
        Fault(
            "drive: fault, reset by somebody again and again",
            "quick stop, exit 3; not enabled again",
            (3,),
            "FAULT",
            say(_download(1, 0x2001, 0x5441, 2), *(_download(1, 0x6040, word, 2) for word in RESET_AND_ENABLE * 8)),
        ),
        Fault(
            "object that the drive refuses (SDO abort)",
            "exit 3 before anything moves, object and code named",
            (3,),
            "abort",
            nothing,
            _refused_object(),
        ),
        Fault(
            "lost frames 1.0%, lockstep",
            "exit 3: an answer is missing",
            (3,),
            "no answer to SYNC",
            disturb(ErrorInjection(seed=6, lost=0.01)),
        ),
        Fault(
            "disk full (at 150 kB)",
            "quick stop, exit 3, trace so far",
            (3,),
            "cannot be written",
            nothing,
            {},
            (),
            150_000,
        ),
        Fault(
            "cycle overrun of 50 ms, real time",
            "missed cycles counted, goes on",
            (0,),
            "",
            hold_up(0.05),
            {"steps": SHORT},
            real_time=True,
        ),
        Fault(
            "node that does not answer (SDO time-out)",
            "exit 3, node named",
            (3,),
            "no answer from axis1",
            nothing,
            _silent_node(),
        ),
    ]


def _disturbances() -> Iterator[Fault]:
    """Lost, duplicated, delayed and corrupted frames; in lockstep a lost answer is not made up for, the others are."""
    for share in (0.001, 0.01, 0.1):
        ridden_out: tuple[str, tuple[int, ...]] = ("ridden out", (0,))
        for pace, delay_s in (("lockstep", 0.0005), ("real time", 0.002)):
            real = pace == "real time"
            expected = ("ridden out, or safe state and exit 3", (0, 3)) if real and share == 0.1 else ridden_out
            for name, injection in (
                ("lost", ErrorInjection(seed=6, lost=share)),
                ("duplicated", ErrorInjection(seed=6, duplicated=share)),
                ("delayed", ErrorInjection(seed=6, delayed=share, delay_s=delay_s)),
                ("corrupted", ErrorInjection(seed=6, corrupted=share)),
            ):
                if name == "lost" and not real:
                    continue
                words = "error passive" if name == "corrupted" and share == 0.1 and not real else ""
                yield Fault(
                    f"{name} frames, {share:.1%}, {pace}",
                    *expected,
                    words,
                    disturb(injection),
                    {"steps": SHORT if real else LONG},
                    real_time=real,
                )


def _of_embedded_bus(fault: Fault) -> bool:
    return fault.name.startswith("hub:") or " frames" in fault.name


def _with_loop_back() -> list[dict[str, Any]]:
    return [
        FOREVER[0],
        {"wait_until": {"condition": "loop_closed < 1", "timeout_s": 1000.0}},
        {"wait_until": {"condition": "loop_closed > 0", "timeout_s": 1000.0, "for_s": 1.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
    ]


def _download(node_id: int, index: int, value: int, size: int) -> Frame:
    head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + b"\0"
    return Frame(0x600 + node_id, head + value.to_bytes(4, "little"))


def _same_id() -> dict[str, Any]:
    nodes = _shipped_nodes()
    nodes["load"]["node_id"] = 2
    return {"nodes": nodes}


def _refused_object() -> dict[str, Any]:
    """1001h, the error register, can't be written: abort 06010002h."""
    nodes = _shipped_nodes()
    nodes["axis1"]["parameters"] = {"1001h": 1}
    return {"nodes": nodes}


def _silent_node() -> dict[str, Any]:
    nodes = _shipped_nodes()
    nodes["axis1"]["simulated"] = False
    return {"nodes": nodes, "master": {"boot_timeout_s": 3.0}}


def _shipped_nodes() -> dict[str, Any]:
    nodes: dict[str, Any] = yaml.safe_load(CONFIG.read_text(encoding="utf-8"))["nodes"]
    for node in nodes.values():
        node["eds"] = str((CONFIG.parent / node["eds"]).resolve())
    return nodes


HEAD = ["| fault | expected | exit | to safe state | kept | |", "|---|---|---|---|---|---|"]


def line(row: Row) -> str:
    """A row of the table in Markdown."""
    cycles = "–" if row.cycles is None else f"{row.cycles} cycles"
    mark = "✓" if row.passed else "busy" if row.busy else "✗"
    return f"| {row.fault.name} | {row.fault.expected} | {row.code} | {cycles} | {row.kept} | {mark} |"


def write(row: Row) -> None:
    """Put a row into the page, by the fault's name; the rows of other faults stay."""
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    old, after = rest.split(END)
    there = {text.split("|")[1].strip(): text for text in old.splitlines() if text.startswith("|")}
    there[row.fault.name] = line(row)
    rows = [there.get(fault.name) for fault in faults()]
    text = "\n".join([BEGIN, *HEAD, *filter(None, rows), END])
    PAGE.write_text(before + text + after, encoding="utf-8")


def main() -> int:
    """Make the faults, print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="write the table into docs/faults.md")
    parser.add_argument("--only", default="", help="only faults whose name this regular expression is found in")
    parser.add_argument("--bus", help="the bus to run on, e.g. socketcan:vcan0, with nobody else on it")
    options = parser.parse_args()
    if options.bus and options.write:
        parser.error("--write: the table is that of the embedded bus, expected no --bus")
    with tempfile.TemporaryDirectory(prefix="faults-") as folder:
        # Buses of our own: `hilbench estop` without an address stops every bus of the user.
        os.environ["XDG_RUNTIME_DIR"] = folder
        return _make(options)


def _make(options: argparse.Namespace) -> int:
    rows = []
    for fault in faults():
        if re.search(options.only, fault.name) and not (options.bus and _of_embedded_bus(fault)):
            row = carry_out(fault, options.bus)
            rows.append(row)
            print(f"{'ok ' if row.passed else 'BAD'} {fault.name}: {row.said[:1000]}", file=sys.stderr, flush=True)
            if options.write:
                write(row)
    print("\n".join([*HEAD, *map(line, rows)]))
    return 0 if all(row.passed for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
