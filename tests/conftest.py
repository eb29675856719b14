"""What tests of several parts share."""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# As `hilbench diagnose` calculates, too: each of several processes with threads for all cores hold one another up.
# The library reads it once, when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell without job control starts what goes on in the background with Ctrl-C ignored, and so would be all that the
# tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Tools import what lies beside them.
sys.path.append(str(Path(__file__).resolve().parents[1] / "tools"))

from tests.bench.whole_runs import STARTED, Shipped, shipped_run
from tests.buses import Bus, KernelBus

import canopen
from hilbench.can.memory import MemoryBus

# What is imported and collected stays: the collector would look through it again and again meanwhile.
gc.disable()

# The same examples each time, however busy the machine: nothing fails by chance.
settings.register_profile(
    "repeatable", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("repeatable")

# Who leaves a bus waits for canopen's thread there: a second, unless told otherwise.
canopen.Network.NOTIFIER_CYCLE = 0.05


def pytest_runtest_setup() -> None:
    """Leave out what CI has no time left for, on a slow machine: the summary counts it, `-rs` lists it."""
    until = os.environ.get("TESTS_UNTIL")
    if until and time.time() > float(until):
        pytest.skip("no time left (TESTS_UNTIL)")


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(params=["memory", pytest.param("kernel", marks=pytest.mark.vcan)])
def bus(request: pytest.FixtureRequest) -> Bus:
    """The bus inside the process and, with `-m vcan`, the kernel's."""
    return MemoryBus() if request.param == "memory" else KernelBus()


@pytest.fixture(scope="session")
def shipped(tmp_path_factory: pytest.TempPathFactory) -> Shipped:
    """What a shipped config does, run once for all that is asked of it, whichever worker asks."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shipped"
    folder.mkdir(exist_ok=True)
    return partial(shipped_run, folder=folder)


@pytest.fixture(autouse=True, scope="module")
def _collections_leave_out_what_stays() -> None:
    """Each bench in this process starts with a full collection: it need not look through all imports and all tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def _no_bench_outlives_its_test() -> Iterator[None]:
    """A test that fails must not leave a bench behind that takes the processors from all others for minutes."""
    yield from _ended()  # but for the bench of a fixture of the module, which was started before


@pytest.fixture(autouse=True, scope="module")
def _no_bench_outlives_its_module() -> Iterator[None]:
    """The same where a fixture of the module has failed."""
    yield from _ended()


def _ended() -> Iterator[None]:
    """Benches that were started meanwhile have ended."""
    before = len(STARTED)
    yield
    for process in STARTED[before:]:
        if process.poll() is None:
            process.kill()
            process.communicate()
