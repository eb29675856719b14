"""Whether a machine keeps time: read from files, judged without a clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hilbench.apps.doctor.check_machine import (
    Lateness,
    MachineFacts,
    check_machine,
    measure_lateness,
    read_machine,
)
from hilbench.apps.doctor.findings import Check, Finding, Level
from hilbench.apps.doctor.subject import Subject
from hilbench.can.open import BusAddress

GOOD = MachineFacts(
    clock_resolution_s=1e-9,
    clock_adjustable=False,
    clock_source="tsc",
    clock_sources=("tsc", "hpet"),
    priority_limit=95,
    locked_memory_bytes=None,
    receive_buffer_bytes=1 << 20,
    kernel="6.1.0-rt",
    preempt_rt=True,
    cores=4,
    isolated_cores="3",
    governors=("performance",),
)
IN_TIME = Lateness(250, 20.0, 60.0, 90.0)
REALTIME = Subject(BusAddress("socketcan", "can0"), realtime=True)


def judge(facts: MachineFacts, lateness: Lateness = IN_TIME, subject: Subject = REALTIME) -> dict[Check, Finding]:
    return {finding.check: finding for finding in check_machine(facts, lateness, subject)}


def not_ok(findings: dict[Check, Finding]) -> list[Check]:
    for finding in findings.values():
        assert bool(finding.advice) == bool(finding.expected) == (finding.level is not Level.OK), finding
        assert "\n" not in finding.advice
    return [check for check, finding in findings.items() if finding.level is not Level.OK]


def test_a_machine_made_for_it() -> None:
    assert not_ok(judge(GOOD)) == []


@pytest.mark.parametrize(
    ("change", "check", "advice"),
    [
        ({"clock_resolution_s": 0.004}, Check.CLOCK, "HIGH_RES_TIMERS"),
        ({"clock_adjustable": True}, Check.CLOCK, "kernel"),
        ({"clock_source": "hpet"}, Check.CLOCK_SOURCE, "echo tsc"),
        ({"clock_source": "hpet", "clock_sources": ("hpet", "acpi_pm")}, Check.CLOCK_SOURCE, "dmesg"),
        ({"priority_limit": 0}, Check.PRIORITY, "rtprio 80"),
        ({"priority_limit": 79}, Check.PRIORITY, "rtprio 80"),
        ({"locked_memory_bytes": 8 << 20}, Check.LOCKED_MEMORY, "memlock unlimited"),
        ({"receive_buffer_bytes": 212992}, Check.RECEIVE_BUFFER, "sysctl -w net.core.rmem_max=1048576"),
        ({"preempt_rt": False}, Check.KERNEL, "linux-image-rt"),
        ({"isolated_cores": ""}, Check.ISOLATED_CORES, "isolcpus"),
        ({"governors": ("performance", "powersave")}, Check.GOVERNOR, "echo performance"),
    ],
)
def test_one_thing_that_is_not_as_it_should_be(change: dict[str, object], check: Check, advice: str) -> None:
    findings = judge(replace(GOOD, **change))  # type: ignore[arg-type]
    assert not_ok(findings) == [check]
    assert advice in findings[check].advice


@pytest.mark.parametrize("lateness", [Lateness(250, 10.0, 201.0, 300.0), Lateness(250, 10.0, 50.0, 2001.0)])
def test_a_late_timer(lateness: Lateness) -> None:
    assert not_ok(judge(GOOD, lateness)) == [Check.TIMER]
    assert not_ok(judge(GOOD, lateness, replace(REALTIME, cycle_s=0.01))) == []


def test_in_lockstep_time_does_not_matter_but_lost_frames_do() -> None:
    bad = replace(GOOD, clock_source="hpet", priority_limit=0, preempt_rt=False, isolated_cores="", governors=("a",))
    lockstep = replace(REALTIME, realtime=False)
    assert not_ok(judge(bad, subject=lockstep)) == []
    assert not_ok(judge(replace(bad, receive_buffer_bytes=1000), subject=lockstep)) == [Check.RECEIVE_BUFFER]
    assert Check.RECEIVE_BUFFER not in judge(bad, subject=replace(lockstep, bus=None))


def files(root: Path, content: dict[str, str]) -> Path:
    for name, text in content.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n")
    return root


def test_what_the_kernel_says_is_read(tmp_path: Path) -> None:
    sources, cpu = "sys/devices/system/clocksource/clocksource0", "sys/devices/system/cpu"
    root = files(
        tmp_path,
        {
            f"{sources}/current_clocksource": "hpet",
            f"{sources}/available_clocksource": "tsc hpet acpi_pm",
            f"{cpu}/isolated": "2-3",
            f"{cpu}/cpu0/cpufreq/scaling_governor": "powersave",
            f"{cpu}/cpu1/cpufreq/scaling_governor": "performance",
            f"{cpu}/cpu2/cpufreq/scaling_governor": "powersave",
            "sys/kernel/realtime": "1",
            "proc/self/status": "Name:\tpython\nCapEff:\t0000000000000000",
            "proc/sys/net/core/rmem_max": "212992",
        },
    )
    facts = read_machine(root)
    assert (facts.clock_source, facts.clock_sources) == ("hpet", ("tsc", "hpet", "acpi_pm"))
    assert facts.isolated_cores == "2-3"
    assert facts.governors == ("performance", "powersave")
    assert facts.preempt_rt
    assert facts.receive_buffer_bytes == 212992
    capable = {"proc/self/status": "CapEff:\t000001ffffffffff"}
    facts = read_machine(files(root, capable))
    assert (facts.priority_limit, facts.locked_memory_bytes, facts.receive_buffer_bytes) == (99, None, None)


def test_a_kernel_that_says_nothing_is_no_fault(tmp_path: Path) -> None:
    facts = read_machine(tmp_path)
    assert facts.clock_source is None
    assert facts.governors == ()
    assert {Check.CLOCK_SOURCE, Check.GOVERNOR, Check.RECEIVE_BUFFER}.isdisjoint(not_ok(judge(facts)))


def test_the_measurement_is_of_whole_cycles() -> None:
    lateness = measure_lateness(0.001, 0.02)
    assert lateness.cycles == 20
    assert 0 <= lateness.p50_us <= lateness.p99_us <= lateness.max_us
