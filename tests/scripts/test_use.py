"""A bench in the hands of somebody who writes scripts: pauses, several benches, and what is asked wrongly."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.bench.whole_runs import config as bench_config
from tests.cli.in_process import hilbench

from hilbench.apps.scripts.bench import Bench
from hilbench.bench import bench as library
from hilbench.bench.lifecycle.participants import Participants
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.errors import BenchNotRunningError, UnusableValueError
from hilbench.results.recording import Recording
from hilbench.runs.config import load

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
#: Longer than devices and supervisor wait for a bench that says nothing.
PAUSE_S = 6.5


def bus() -> str:
    return f"embedded:t{uuid.uuid4().hex[:10]}"


def here(**options: Any) -> Bench:
    return Bench(CONFIG, bus=bus(), participants=Participants.IN_PROCESS, **options)


def same(one: Recording, other: Recording) -> bool:
    return list(one.channels) == list(other.channels) and all(np.array_equal(one[n], other[n]) for n in one.channels)


def ramp(bench: Bench) -> None:
    bench.ramp("line_speed_m_s", 1.0, duration_s=0.3)


def step(bench: Bench) -> Recording:
    bench.step("load.web.youngs_modulus_Pa", 10e9)
    bench.run(0.3)
    return bench.recording


# -- pauses ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_pause_between_two_cells_of_a_notebook_changes_nothing() -> None:
    with here() as bench:
        ramp(bench)
        without = step(bench)
    with Bench(CONFIG, bus=bus(), participants=Participants.STARTED) as started, here() as inside:
        benches = (started, inside)
        time.sleep(PAUSE_S)  # a plot, before anything has moved
        for bench in benches:
            ramp(bench)
        time.sleep(PAUSE_S)
        for bench in benches:
            assert same(step(bench), without)
    for bench in benches:
        assert (list(bench.notices), bench.safe_state_problems) == ([], [])


PAUSED_SCRIPT = """
import sys
from hilbench import Bench

with Bench(sys.argv[1], bus=sys.argv[2], changes=["safety.cycle_timeout_s=1"]) as bench:
    bench.ramp("line_speed_m_s", 1.0, duration_s=0.3)
    print("pause", flush=True)
    sys.stdin.readline()
    bench.run(0.1)
"""


class Paused:
    """A script in a process of its own that pauses while the line runs, and a listener on its bus."""

    def __init__(self) -> None:
        self.bus = bus()
        words = [sys.executable, "-c", PAUSED_SCRIPT, str(CONFIG), self.bus]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        self.process = subprocess.Popen(words, text=True, **pipes)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "pause\n"
        self.link = open_link(BusAddress.parse(self.bus, timing="virtual"))

    def hear(self, can_id: int, within_s: float = 60.0) -> Frame:
        deadline_s = time.monotonic() + within_s
        while time.monotonic() < deadline_s:
            for frame in self.link.receive(0.1):
                if frame.can_id == can_id:
                    return frame
        raise AssertionError(f"no frame {can_id:03X}h")

    def end(self) -> str:
        """What it says when it goes on."""
        self.link.close()
        return self.process.communicate("\n", timeout=60)[1]


@pytest.mark.slow
def test_a_process_that_is_stopped_in_a_pause_has_its_drives_stopped() -> None:
    paused = Paused()
    assert paused.hear(0x77F).data == b"\x05"
    os.kill(paused.process.pid, signal.SIGSTOP)
    paused.hear(EMERGENCY_STOP_COB_ID)  # the supervisor's
    os.kill(paused.process.pid, signal.SIGCONT)
    assert "emergency stop (COB-ID 001h) on the bus" in paused.end().splitlines()[-1]


@pytest.mark.slow
def test_a_process_that_is_killed_in_a_pause_has_its_drives_stopped() -> None:
    paused = Paused()
    paused.process.kill()
    paused.hear(EMERGENCY_STOP_COB_ID)
    paused.end()


@pytest.mark.slow
def test_an_emergency_stop_in_a_pause_stops_the_bench_at_its_next_cycle() -> None:
    paused = Paused()
    stopped = hilbench("estop", "--bus", paused.bus)
    assert stopped.returncode == 0, stopped.stderr
    assert "emergency stop (COB-ID 001h) on the bus" in paused.end().splitlines()[-1]


class Heartbeats:
    """Counts those of the bench."""

    def __init__(self) -> None:
        self.count = 0

    def write(self, frames: Sequence[Frame]) -> None:
        self.count += sum(frame.can_id == 0x77F for frame in frames)

    def end_cycle(self) -> None:
        pass


class Hanging:
    """An observer in which a cycle hangs for some periods of the heartbeat; notes how many were sent meanwhile."""

    def __init__(self, received: Heartbeats) -> None:
        self._received = received
        self.sent: int | None = None

    def sample(self, sample: object) -> None:
        if self.sent is None:
            before = self._received.count
            time.sleep(0.5)
            self.sent = self._received.count - before


def test_a_cycle_that_hangs_says_nothing_and_a_pause_does(tmp_path: Path) -> None:
    loaded = load(bench_config(tmp_path, master={"heartbeat_ms": 20}))[0]
    received = Heartbeats()
    hanging = Hanging(received)
    with library.Bench(
        loaded, observers=[hanging], tap=received, may_idle=True, participants=Participants.IN_PROCESS
    ) as bench:
        bench.cycle()
        before = received.count
        while received.count < before + 3:
            time.sleep(0.01)
    assert hanging.sent == 0


# -- several benches -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_benches_at_a_time_in_one_process_don_t_meet() -> None:
    with here() as bench:
        ramp(bench)
        alone = step(bench)
    with here() as one, Bench(CONFIG, bus=bus(), changes=["controllers.tension_control.set_point_N=95"]) as other:
        for k in range(150):
            for bench in (one, other):
                bench.set("line_speed_m_s", (k + 1) / 150)
                bench.cycle()
        for bench in (other, one):
            bench.step("load.web.youngs_modulus_Pa", 10e9)
            bench.run(0.3)
    assert np.array_equal(one.recording["x2_m"], alone["x2_m"])
    assert set(other.recording["F_ref_N"]) == {95.0}
    assert (one.safe_state_problems, other.safe_state_problems) == ([], [])


# -- what is asked at the wrong time ---------------------------------------------------------------------------------

USES: list[Callable[[Bench], object]] = [
    lambda bench: bench.cycle(),
    lambda bench: bench.run(1.0),
    lambda bench: bench.get("line_speed_m_s"),
    lambda bench: bench.set("line_speed_m_s", 1.0),
    lambda bench: bench.set("hardware.effects.coulomb_friction.axis1.force_N", 1.0),
    lambda bench: bench.step("load.web.youngs_modulus_Pa", 9e9),
    lambda bench: bench.ramp("line_speed_m_s", 1.0, duration_s=1.0),
    lambda bench: bench.wait_until(lambda now: True, timeout_s=1.0),
    lambda bench: bench.follow(iter_forever()),
    lambda bench: bench.step_response("load.web.youngs_modulus_Pa", 9e9),
    lambda bench: bench.restart_twin(),
    lambda bench: bench.use_synchronizer("pid"),
]


def iter_forever() -> Any:
    while True:
        yield


@pytest.fixture(scope="module")
def left() -> Bench:
    with here() as bench:
        bench.run(0.01)
    return bench


@pytest.mark.parametrize("use", range(len(USES)))
def test_a_bench_that_is_not_running_says_so_in_a_line(use: int, left: Bench) -> None:
    for bench, where in ((here(), "has not been entered"), (left, "has been left")):
        with pytest.raises(BenchNotRunningError, match=rf"the bench {where}, expected 'with Bench\(…\) as bench:'"):
            USES[use](bench)
    assert left.events == []


def test_a_bench_is_entered_once(left: Bench) -> None:
    with pytest.raises(BenchNotRunningError, match="has been left, expected a new Bench"), left:
        pass
    with here() as bench:
        with pytest.raises(BenchNotRunningError, match="has been entered already"), bench:
            pass
        bench.run(0.01)  # and is none the worse for it


FORGETFUL_SCRIPT = """
import sys
from hilbench import Bench
from hilbench.bench.lifecycle.participants import Participants

bench = Bench(sys.argv[1], bus=sys.argv[2], participants=Participants[sys.argv[3]])
bench.__enter__()
bench.ramp("line_speed_m_s", 0.5, duration_s=0.2)
if len(sys.argv) > 4:
    raise SystemExit("the script's own words")
"""


@pytest.mark.slow
@pytest.mark.parametrize(("participants", "words"), [("STARTED", ["fails"]), ("IN_PROCESS", [])], ids=["fails", "ends"])
def test_a_bench_that_is_never_left_is_stopped_and_said_in_a_line(participants: str, words: list[str]) -> None:
    name = bus()
    command = [sys.executable, "-c", FORGETFUL_SCRIPT, str(CONFIG), name, participants, *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    said = done.stderr.splitlines()
    assert said[-1] == (
        "hilbench: the bench 'web_section_step' was never left, and is stopped now; expected 'with Bench(…)'"
    )
    assert said[:-1] == (["the script's own words"] if words else [])
    assert done.returncode == len(words)
    running = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists()]
    assert not [line for line in running if name.partition(":")[2].encode() in line]


# -- what is asked wrongly -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def running() -> Any:
    with here() as bench:
        bench.run(0.01)
        yield bench


NO_TIMES = ["1", None, -1.0, math.nan, math.inf, 1e12, [1.0], True]
WRONG: list[tuple[str, Callable[[Bench], object], str]] = [
    *[(f"run {t!r}", lambda b, t=t: b.run(t), "duration_s is .*, expected a number from 0") for t in NO_TIMES],
    *[
        (f"ramp {t!r}", lambda b, t=t: b.ramp("line_speed_m_s", 1.0, t), "duration_s is .*, expected a number above 0")
        for t in [*NO_TIMES, 0]
    ],
    *[
        (
            f"wait {t!r}",
            lambda b, t=t: b.wait_until(lambda now: True, timeout_s=t),
            "timeout_s is .*, expected a number",
        )
        for t in [*NO_TIMES, 0]
    ],
    ("wait for text", lambda b: b.wait_until(lambda now: True, timeout_s=1.0, for_s="1"), "for_s is '1', expected"),
    ("wait too long", lambda b: b.wait_until(lambda now: True, timeout_s=1.0, for_s=2.0), "for_s is 2, .* at most"),
    ("wait for True", lambda b: b.wait_until(True, timeout_s=1.0), "condition is True, expected a function"),
    ("path", lambda b: b.set("line_sped_m_s", 1.0), "path 'line_sped_m_s', .*did you mean 'line_speed_m_s'"),
    ("path of an effect", lambda b: b.get("load.effects.web_dampin.time_s"), "did you mean 'web_damping'"),
    ("path to ramp", lambda b: b.ramp("line_sped_m_s", 1.0, 1.0), "did you mean 'line_speed_m_s'"),
    ("path to step", lambda b: b.step_response("line_sped_m_s", 1.0), "did you mean 'line_speed_m_s'"),
    ("number for a path", lambda b: b.set(3, 1.0), "path 3, expected text such as 'line_speed_m_s'"),
    ("ramp of a switch", lambda b: b.ramp("load.web.broken", 1.0, 1.0), "a switch"),
    ("text for a value", lambda b: b.set("line_speed_m_s", "3"), "line_speed_m_s is '3', expected a number from"),
    ("no number", lambda b: b.step("line_speed_m_s", math.nan), "line_speed_m_s is nan, expected a number from"),
    ("ramp to text", lambda b: b.ramp("line_speed_m_s", "3", 1.0), "line_speed_m_s is '3', expected a number from"),
    ("hold of text", lambda b: b.step_response("line_speed_m_s", 1.0, hold_s="2"), "hold_s is '2', expected"),
    ("speed of text", lambda b: b.step_response("line_speed_m_s", 1.0, line_speed_m_s="2"), "is '2', expected"),
    ("method", lambda b: b.use_synchronizer("ekff"), "method 'ekff', .*did you mean 'ekf'"),
]


@pytest.mark.parametrize(("use", "said"), [row[1:] for row in WRONG], ids=[row[0] for row in WRONG])
def test_what_cannot_be_done_is_said_before_anything_moves(use: Callable[[Bench], object], said: str, running: Bench):
    cycles = running.last.cycle
    with pytest.raises(UnusableValueError, match=said) as caught:
        use(running)
    assert "\n" not in str(caught.value)
    assert (running.last.cycle, running.get("line_speed_m_s"), running.events) == (cycles, 0.0, [])
