"""Real-time capabilities of this machine: clock, scheduling rights, kernel, and timer lateness."""

from __future__ import annotations

import os
import resource
import time
from dataclasses import dataclass
from pathlib import Path

from hilbench.exchange import pacing

_ROOT = Path("/")
_CAP_NET_ADMIN, _CAP_IPC_LOCK, _CAP_SYS_NICE = 12, 14, 23  # <linux/capability.h>


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
