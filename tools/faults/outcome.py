"""What came of a fault: exit code, words, cycles to the safe state, data kept."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass

from faults.run import CLI, Fault, Run, started
from hilbench.canopen.identifiers import SDO_ANSWER
from hilbench.cia402.state_machine import POWERED, STATUS_TARGET_REACHED, State, decode_statusword
from hilbench.errors import HilbenchError
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.trace import TraceReader

#: Share of missed cycles from which a machine is too busy for a verdict, and how often a row is tried.
BUSY, TRIES = 0.02, 3
DRIVES = (1, 2, 3)
QUICK_STOP = b"\x02\x00"


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
        elif can_id - SDO_ANSWER in states and data[1:3] == b"\x41\x60":
            states[can_id - SDO_ANSWER] = _stands(int.from_bytes(data[4:6], "little"))
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


def execute(fault: Fault, bus: str | None) -> Row:
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
