"""A process that works in slices: it rests, also where it does not come back to the interpreter."""

from __future__ import annotations

import subprocess
import sys

from hilbench.cpu_throttle import WORK_S

#: One call of a library, long enough for some slices; how often it has slept meanwhile, and its CPU time.
SORTS = """if True:
    import resource, sys, time
    import numpy as np
    from hilbench.cpu_throttle import throttle_cpu
    values = np.random.default_rng(0).random(5_000_000)
    if sys.argv[1] == "slices":
        throttle_cpu()
    began_s, slept = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw
    values.sort(kind="stable")  # the default one takes 40 ms where the processor has long vectors
    print(time.process_time() - began_s, resource.getrusage(resource.RUSAGE_SELF).ru_nvcsw - slept)
"""


def sorted_with(how: str) -> tuple[float, int]:
    """CPU time, s, and how often it has waited."""
    ended = subprocess.run([sys.executable, "-c", SORTS, how], capture_output=True, text=True, timeout=60, check=True)
    cpu_s, waited = ended.stdout.split()
    return float(cpu_s), int(waited)


def test_it_rests_in_the_middle_of_one_long_call() -> None:
    cpu_s, waited = sorted_with("slices")
    assert cpu_s > 4 * WORK_S
    assert waited >= 0.5 * cpu_s / WORK_S
    assert sorted_with("in one piece")[1] < 0.25 * waited
