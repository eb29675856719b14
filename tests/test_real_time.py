"""What a process is given while its loop runs, and that it gives it back."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path

from hilbench.real_time import ProcessSettings, comes_first, kept_ready


def locked_kib() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck:"))


def as_it_is() -> tuple[object, ...]:
    return os.sched_getscheduler(0), os.sched_getaffinity(0), locked_kib(), gc.isenabled()


def test_everything_that_is_permitted_is_given_and_taken_back() -> None:
    before, core, told = as_it_is(), min(os.sched_getaffinity(0)), list[str]()
    with kept_ready(ProcessSettings(priority=1, core=core, lock_memory=True), told.append):
        policy, cores, locked, collects = as_it_is()
        assert comes_first() is (policy == os.SCHED_FIFO)
    assert not comes_first()
    assert cores == {core}
    assert not collects
    assert (policy == os.SCHED_FIFO) is not any("rtprio is" in text for text in told)
    assert (locked != 0) is not any("memlock is" in text for text in told)
    assert as_it_is() == before


def test_what_is_not_permitted_is_told_in_a_line_and_left_out() -> None:
    # In a process without the rights, whoever runs the tests.
    code = """if True:
        import ctypes, os, resource
        from hilbench.real_time import ProcessSettings, kept_ready
        resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
        if os.getuid() == 0:
            os.setuid(65534)
        with kept_ready(ProcessSettings(priority=80, core=4095, lock_memory=True), print):
            print("runs")
    """
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    core, priority, memory, runs = ended.stdout.splitlines()
    assert core.startswith("core 4095: cannot be had, expected one of 0")
    assert priority == "priority 80: SCHED_FIFO is not permitted, rtprio is 0; see hilbench doctor"
    assert memory == "lock_memory: not permitted, memlock is 64 KiB; see hilbench doctor"
    assert runs == "runs"


def test_in_lockstep_only_the_garbage_collector_is_kept_out() -> None:
    before = as_it_is()
    with kept_ready(None, print):
        assert as_it_is() == (*before[:-1], False)
    assert as_it_is() == before
