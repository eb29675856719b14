"""Check if a machine is fit for the pace of a bench: clock, scheduling rights, kernel and timer, read and judged."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hilbench.apps.doctor.findings import Check, Finding, ok, warning
from hilbench.apps.doctor.subject import Subject
from hilbench.can.socketcan import RECEIVE_BUFFER_BYTES
from hilbench.exchange import pacing

_ROOT = Path("/")
_CAP_NET_ADMIN, _CAP_IPC_LOCK, _CAP_SYS_NICE = 12, 14, 23  # <linux/capability.h>
SUBJECT = "this machine"
#: The priority that docs/real_stand.md gives the bench: above everything but the kernel's own threads.
PRIORITY = 80
_FINEST_CLOCK_S = 1e-6
_SLOW_CLOCK_SOURCES = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")
#: Share of the cycle by which the timer may be late, at the 99th percentile.
_LATE_SHARE = 0.1
_LIMITS = "/etc/security/limits.d/hilbench.conf"


@dataclass(frozen=True)
class MachineFacts:
    """None where the kernel does not say."""

    clock_resolution_s: float
    clock_adjustable: bool  #: whether setting the wall clock sets this clock too
    clock_source: str | None
    clock_sources: tuple[str, ...]  #: that could be chosen
    priority_limit: int  #: highest real-time priority this user may ask for (RLIMIT_RTPRIO); 99 with CAP_SYS_NICE
    locked_memory_bytes: int | None  #: RLIMIT_MEMLOCK; None: no limit
    receive_buffer_bytes: int | None  #: largest a socket may ask for (net.core.rmem_max); None: no limit
    kernel: str
    preempt_rt: bool
    cores: int
    isolated_cores: str  #: list of cores that the scheduler leaves alone, such as "2-3"
    governors: tuple[str, ...]  #: of the cores' clocks, each once; empty where the frequency is not scaled


@dataclass(frozen=True)
class Lateness:
    """Wake-up lateness of a loop of absolute deadlines, µs."""

    cycles: int
    p50_us: float
    p99_us: float
    max_us: float


def read_machine(root: Path = _ROOT) -> MachineFacts:
    """Read it from this process' limits and from the files below `root` (/proc, /sys)."""
    clock = time.get_clock_info("monotonic")
    capabilities = _effective_capabilities(root)
    sources = root / "sys/devices/system/clocksource/clocksource0"
    locked = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    buffer = _text(root / "proc/sys/net/core/rmem_max")
    governors = {_text(path) for path in root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")}
    kernel = os.uname()
    return MachineFacts(
        clock_resolution_s=clock.resolution,
        clock_adjustable=clock.adjustable,
        clock_source=_text(sources / "current_clocksource") or None,
        clock_sources=tuple(_text(sources / "available_clocksource").split()),
        priority_limit=99 if capabilities >> _CAP_SYS_NICE & 1 else _priority_limit(),
        locked_memory_bytes=None if locked == resource.RLIM_INFINITY or capabilities >> _CAP_IPC_LOCK & 1 else locked,
        receive_buffer_bytes=None if capabilities >> _CAP_NET_ADMIN & 1 or not buffer else int(buffer),
        kernel=kernel.release,
        preempt_rt=_text(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in kernel.version,
        cores=len(os.sched_getaffinity(0)),
        isolated_cores=_text(root / "sys/devices/system/cpu/isolated"),
        governors=tuple(sorted(filter(None, governors))),
    )


def measure_lateness(cycle_s: float, duration_s: float) -> Lateness:
    """Run the bench's own loop of deadlines for a while, doing nothing in it."""
    state = pacing.bare_loop(round(cycle_s * 1e9), max(1, round(duration_s / cycle_s)))
    late_us = sorted(late_ns / 1000.0 for late_ns in state.lateness_ns)
    at = [late_us[min(len(late_us) - 1, int(share * len(late_us)))] for share in (0.5, 0.99)]
    return Lateness(len(late_us), at[0], at[1], late_us[-1])


def _priority_limit() -> int:
    soft = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    return 99 if soft == resource.RLIM_INFINITY else soft


def _effective_capabilities(root: Path) -> int:
    for line in _text(root / "proc/self/status").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], 16)
    return 0


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""


def check_machine(facts: MachineFacts, lateness: Lateness, subject: Subject) -> list[Finding]:
    """Findings on the machine. In lockstep nothing of it can be wrong but the clock."""
    findings = [_clock(facts)]
    if subject.on_socketcan:
        findings.append(_receive_buffer(facts))
    timed = [_clock_source(facts), _timer(lateness, subject), *_rights(facts), *_scheduling(facts)]
    if not subject.realtime:
        timed = [ok(finding.check, finding.subject, f"{finding.found} (lockstep: no matter)") for finding in timed]
    return findings + timed


def _unless(is_fine: bool, check: Check, fine: str, found: str, problem: str = "", **values: object) -> Finding:
    """Finding where all is well, and otherwise."""
    return ok(check, SUBJECT, fine) if is_fine else warning(check, SUBJECT, found, problem, **values)


def _clock(facts: MachineFacts) -> Finding:
    found = f"CLOCK_MONOTONIC, resolution {facts.clock_resolution_s * 1e9:g} ns"
    follows = ", set with the wall clock" if facts.clock_adjustable else ""
    is_fine = not follows and facts.clock_resolution_s <= _FINEST_CLOCK_S
    return _unless(is_fine, Check.CLOCK, f"{found}; setting the wall clock does not move SYNC", found + follows)


def _clock_source(facts: MachineFacts) -> Finding:
    source = facts.clock_source
    better = next((name for name in facts.clock_sources if name not in _SLOW_CLOCK_SOURCES), None)
    known, problem = source or "not reported by the kernel", "" if better else "no_clock_source"
    return _unless(source not in _SLOW_CLOCK_SOURCES, Check.CLOCK_SOURCE, known, known, problem, better=better)


def _timer(lateness: Lateness, subject: Subject) -> Finding:
    found = (
        f"late by {lateness.p50_us:.0f} µs (p50), {lateness.p99_us:.0f} µs (p99), {lateness.max_us:.0f} µs (largest) "
        f"in {lateness.cycles} cycles of {subject.cycle_s * 1e3:g} ms"
    )
    cycle_us = subject.cycle_s * 1e6
    p99_us = _LATE_SHARE * cycle_us
    is_fine = lateness.p99_us <= p99_us and lateness.max_us <= cycle_us
    return _unless(is_fine, Check.TIMER, found, found, p99_us=p99_us, cycle_us=cycle_us, priority=PRIORITY)


def _rights(facts: MachineFacts) -> Iterator[Finding]:
    priority, locked_bytes = facts.priority_limit, facts.locked_memory_bytes
    found = f"rtprio {priority}" + ("" if priority else ": SCHED_FIFO is not allowed")
    allowed = f"SCHED_FIFO up to {priority} allowed"
    yield _unless(priority >= PRIORITY, Check.PRIORITY, allowed, found, priority=PRIORITY, limits=_LIMITS)
    found = f"memlock {(locked_bytes or 0) >> 10} KiB"
    allowed = "memory may be locked, no limit"
    yield _unless(locked_bytes is None, Check.LOCKED_MEMORY, allowed, found, limits=_LIMITS)


def _scheduling(facts: MachineFacts) -> Iterator[Finding]:
    kernel, isolated, governors = facts.kernel, facts.isolated_cores, facts.governors
    yield _unless(facts.preempt_rt, Check.KERNEL, f"{kernel}, PREEMPT_RT", f"{kernel}, not PREEMPT_RT")
    yield _unless(bool(isolated), Check.ISOLATED_CORES, isolated, f"none of {facts.cores}")
    scaled = " ".join(governors) or "frequency is not scaled here"
    yield _unless(governors in ((), ("performance",)), Check.GOVERNOR, scaled, ", ".join(governors))


def _receive_buffer(facts: MachineFacts) -> Finding:
    limit = facts.receive_buffer_bytes
    fine = "as large as asked for" if limit is None else f"up to {limit >> 10} KiB"
    found, wanted = f"net.core.rmem_max {limit} bytes", RECEIVE_BUFFER_BYTES
    return _unless(limit is None or limit >= wanted, Check.RECEIVE_BUFFER, fine, found, wanted=wanted)
