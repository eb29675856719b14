"""Check that a machine is fit for the pace of a bench: pure functions of what was read and measured."""

from __future__ import annotations

from dataclasses import dataclass

from hilbench.apps.doctor.findings import Check, Finding, ok, warning
from hilbench.apps.doctor.machine import Lateness, MachineFacts
from hilbench.can.socketcan import RECEIVE_BUFFER_BYTES

SUBJECT = "this machine"
#: The priority that docs/real_stand.md gives the bench: above everything but the kernel's own threads.
PRIORITY = 80
_FINEST_CLOCK_S = 1e-6
_SLOW_CLOCK_SOURCES = ("hpet", "acpi_pm", "jiffies", "refined-jiffies", "pit")
#: Share of the cycle by which the timer may be late, at the 99th percentile.
_LATE_SHARE = 0.1
_LIMITS = "/etc/security/limits.d/hilbench.conf"


@dataclass(frozen=True)
class MachineNeeds:
    """Requirements of the bench on the machine."""

    realtime: bool  #: False: in lockstep only the result counts, not when it comes
    cycle_s: float
    socketcan: bool


def check_machine(facts: MachineFacts, lateness: Lateness, needs: MachineNeeds) -> list[Finding]:
    """Findings on the machine. In lockstep nothing of it can be wrong but the clock."""
    findings = [_clock(facts)]
    if needs.socketcan:
        findings.append(_receive_buffer(facts))
    timed = [
        _clock_source(facts),
        _timer(lateness, needs),
        _priority(facts),
        _locked_memory(facts),
        _kernel(facts),
        _isolated_cores(facts),
        _governor(facts),
    ]
    if not needs.realtime:
        timed = [ok(finding.check, finding.subject, f"{finding.found} (lockstep: no matter)") for finding in timed]
    return findings + timed


def _clock(facts: MachineFacts) -> Finding:
    found = f"CLOCK_MONOTONIC, resolution {facts.clock_resolution_s * 1e9:g} ns"
    if facts.clock_adjustable or facts.clock_resolution_s > _FINEST_CLOCK_S:
        follows = ", set with the wall clock" if facts.clock_adjustable else ""
        return warning(
            Check.CLOCK,
            SUBJECT,
            found + follows,
            "1 µs or finer, not set with the wall clock",
            "use a kernel with high-resolution timers (CONFIG_HIGH_RES_TIMERS)",
        )
    return ok(Check.CLOCK, SUBJECT, f"{found}; setting the wall clock does not move SYNC")


def _clock_source(facts: MachineFacts) -> Finding:
    if facts.clock_source is None:
        return ok(Check.CLOCK_SOURCE, SUBJECT, "not reported by the kernel")
    if facts.clock_source in _SLOW_CLOCK_SOURCES:
        better = next((name for name in facts.clock_sources if name not in _SLOW_CLOCK_SOURCES), None)
        place = "/sys/devices/system/clocksource/clocksource0/current_clocksource"
        advice = (
            f"echo {better} | sudo tee {place}"
            if better
            else "none is offered here: see 'clocksource' in the output of: sudo dmesg"
        )
        return warning(Check.CLOCK_SOURCE, SUBJECT, facts.clock_source, "one read without a device (tsc)", advice)
    return ok(Check.CLOCK_SOURCE, SUBJECT, facts.clock_source)


def _timer(lateness: Lateness, needs: MachineNeeds) -> Finding:
    found = (
        f"late by {lateness.p50_us:.0f} µs (p50), {lateness.p99_us:.0f} µs (p99), {lateness.max_us:.0f} µs (largest) "
        f"in {lateness.cycles} cycles of {needs.cycle_s * 1e3:g} ms"
    )
    cycle_us = needs.cycle_s * 1e6
    if lateness.p99_us > _LATE_SHARE * cycle_us or lateness.max_us > cycle_us:
        return warning(
            Check.TIMER,
            SUBJECT,
            found,
            f"p99 up to {_LATE_SHARE * cycle_us:.0f} µs, none over {cycle_us:.0f} µs",
            f"give it real-time priority and a core of its own: chrt -f {PRIORITY} taskset -c CORE hilbench run ...",
        )
    return ok(Check.TIMER, SUBJECT, found)


def _priority(facts: MachineFacts) -> Finding:
    if facts.priority_limit >= PRIORITY:
        return ok(Check.PRIORITY, SUBJECT, f"SCHED_FIFO up to {facts.priority_limit} allowed")
    return warning(
        Check.PRIORITY,
        SUBJECT,
        f"rtprio {facts.priority_limit}: SCHED_FIFO is not allowed"
        if not facts.priority_limit
        else f"rtprio {facts.priority_limit}",
        f"rtprio {PRIORITY} or more",
        f"echo '@realtime - rtprio {PRIORITY}' | sudo tee -a {_LIMITS}; join the group realtime; log in anew",
    )


def _locked_memory(facts: MachineFacts) -> Finding:
    limit = facts.locked_memory_bytes
    if limit is None:
        return ok(Check.LOCKED_MEMORY, SUBJECT, "memory may be locked, no limit")
    return warning(
        Check.LOCKED_MEMORY,
        SUBJECT,
        f"memlock {limit >> 10} KiB",
        "unlimited, so that the bench can keep its memory from being paged out",
        f"echo '@realtime - memlock unlimited' | sudo tee -a {_LIMITS}; join the group realtime; log in anew",
    )


def _kernel(facts: MachineFacts) -> Finding:
    if facts.preempt_rt:
        return ok(Check.KERNEL, SUBJECT, f"{facts.kernel}, PREEMPT_RT")
    return warning(
        Check.KERNEL,
        SUBJECT,
        f"{facts.kernel}, not PREEMPT_RT",
        "a kernel with PREEMPT_RT, where SYNC must never be late",
        "sudo apt install linux-image-rt-amd64 (Debian), then reboot into it",
    )


def _isolated_cores(facts: MachineFacts) -> Finding:
    if facts.isolated_cores:
        return ok(Check.ISOLATED_CORES, SUBJECT, facts.isolated_cores)
    return warning(
        Check.ISOLATED_CORES,
        SUBJECT,
        f"none of {facts.cores}",
        "one core for the bench alone",
        "add isolcpus=CORE nohz_full=CORE to GRUB_CMDLINE_LINUX in /etc/default/grub; sudo update-grub; reboot",
    )


def _governor(facts: MachineFacts) -> Finding:
    if not facts.governors or facts.governors == ("performance",):
        return ok(Check.GOVERNOR, SUBJECT, " ".join(facts.governors) or "frequency is not scaled here")
    return warning(
        Check.GOVERNOR,
        SUBJECT,
        ", ".join(facts.governors),
        "performance on every core",
        "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor",
    )


def _receive_buffer(facts: MachineFacts) -> Finding:
    limit = facts.receive_buffer_bytes
    if limit is None or limit >= RECEIVE_BUFFER_BYTES:
        return ok(
            Check.RECEIVE_BUFFER, SUBJECT, "as large as asked for" if limit is None else f"up to {limit >> 10} KiB"
        )
    return warning(
        Check.RECEIVE_BUFFER,
        SUBJECT,
        f"net.core.rmem_max {limit} bytes",
        f"{RECEIVE_BUFFER_BYTES} bytes: 0.3 s of a full bus",
        f"sudo sysctl -w net.core.rmem_max={RECEIVE_BUFFER_BYTES}",
    )
