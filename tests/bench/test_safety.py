"""Faults of a running bench: every one ends in the safe state, or is ridden out, and is told."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import (
    ENDLESS,
    config,
    gone,
    pid_of,
    result_of,
    run_folders,
    run_here,
    start,
    wait_for_frames,
)

from hilbench.results.recording import Recording, read_recording
from hilbench.results.trace import TraceReader

QUICK_STOP_M_S2 = 3.0
CYCLE_S = 0.002
METRES_PER_RAD = 0.2 / 5.0


def velocity_m_s(trace: Path, cob_id: int = 0x281) -> np.ndarray:
    """Velocity of axis 1 (606Ch) in every frame that told it."""
    unit = 0.0001 / 60.0 * 2.0 * np.pi * METRES_PER_RAD
    raw = [int.from_bytes(data, "little", signed=True) for can_id, data, _ in TraceReader(trace) if can_id == cob_id]
    return np.asarray(raw) * unit


def settled(recording: Recording, name: str) -> np.ndarray:
    return np.asarray(recording[name])


@pytest.mark.slow
def test_emergency_stop_from_another_terminal(tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS)
    process = start(path)
    folder = wait_for_frames(path, 500)
    address = Path(path).read_text().split("address: ")[1].split()[0]
    command = [sys.executable, "-m", "hilbench", "estop", "--bus", address]
    stop = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    out, _ = process.communicate(timeout=60)
    assert stop.returncode == 0, stop.stderr
    assert process.returncode == 3
    assert "emergency stop (COB-ID 001h) on the bus" in out.replace("\n", " ")
    faults = result_of(folder).faults
    assert [fault.source for fault in faults] == ["bench"]  # and no problem of the safe state
    frames = list(TraceReader(folder / "trace.log"))
    at = next(n for n, frame in enumerate(frames) if frame.can_id == 0x001)
    after = frames[at:]
    # The next thing on the bus but for frames under way: no set point goes out any more.
    assert not [frame for frame in after if 0x200 < frame.can_id < 0x280]
    # All three drives were asked until they had stopped: statusword by SDO.
    answers = [frame for frame in after if 0x581 <= frame.can_id <= 0x583 and frame.data[1:3] == b"\x41\x60"]
    for node in (1, 2, 3):
        last = [frame.data[4] for frame in answers if frame.can_id == 0x580 + node][-1]
        assert last & 0x6F not in (0x27, 0x0F)  # neither OPERATION ENABLED nor FAULT REACTION ACTIVE
    assert gone(path)


def test_a_trip_stops_with_bounded_deceleration_and_says_why(tmp_path: Path) -> None:
    limits = {"speed_m_s": {"warning": 0.6, "trip": 0.8}}
    path = config(tmp_path, safety={"limits": limits, "quick_stop_m_s2": QUICK_STOP_M_S2})
    code, out, _ = run_here(path, report=True)
    folder = run_folders(path)[0]
    assert code == 3
    result = result_of(folder)
    for text in (result.faults[0].text, out.replace("\n", " "), (folder / "report.html").read_text()):
        assert "beyond its trip level 0.8 m/s" in text
        assert "speed of axis" in text
    assert any("beyond its warning level 0.6 m/s" in warning for warning in result.all_warnings())
    speed = velocity_m_s(folder / "trace.log")
    peak = int(np.argmax(speed))
    assert speed[peak] < 0.8 * 1.05
    # Measured over 20 cycles, so that the noise of the velocity does not count. The velocity loop overshoots when the
    # ramp begins; a drive that brakes at its torque limit would slow down by 7.5 m/s².
    slowing = (speed[peak:-20] - speed[peak + 20 :]) / (20 * CYCLE_S)
    stopping_s = CYCLE_S * np.count_nonzero(speed[peak:] > 0.05)
    assert abs((speed[peak] - 0.05) / stopping_s / QUICK_STOP_M_S2 - 1.0) < 0.15
    assert np.max(slowing) < 1.6 * QUICK_STOP_M_S2
    assert abs(speed[-1]) < 0.03


@pytest.mark.slow
def test_a_twin_that_is_killed_is_started_again_while_the_loop_holds(tmp_path: Path) -> None:
    # The line waits for what the twin needs: a loop that is closed again.
    steps = [
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
        {"wait_until": {"condition": "loop_closed < 1", "timeout_s": 1000.0}},
        {"wait_until": {"condition": "loop_closed > 0", "timeout_s": 1000.0, "for_s": 1.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
    ]
    # The damping goes on beside the loop, open or closed: what it makes of the encoders' noise would hide a bump.
    control = {"set_point_N": 80.0, "swing_damping_ratio": 0.0}
    path = config(tmp_path, steps=steps, safety={"cycle_timeout_s": 1.0}, controllers={"tension_control": control})
    process = start(path)
    folder = wait_for_frames(path, 1200)
    os.kill(pid_of(path, "hilbench.twin"), signal.SIGKILL)
    out, _ = process.communicate(timeout=120)
    assert process.returncode == 0, out
    found = read_recording(folder / "recording.mf4")
    closed = settled(found, "loop_closed")
    opened = int(np.flatnonzero((closed[:-1] == 1) & (closed[1:] == 0))[-1]) + 1
    again = opened + int(np.argmax(closed[opened:]))
    v1 = settled(found, "v1_cmd_m_s")
    # Without a bump, when it opens and when it closes: ES/v is 283 N per mm/s here.
    assert np.max(np.abs(np.diff(v1[opened - 2 : again + 3]))) < 1e-4
    tension = settled(found, "F_true_N")
    # The loop may have been busy when it opened; what it was at then has left the span after some seconds.
    assert np.max(np.abs(tension[opened:again] - 80.0)) < 20.0
    # The twin knows the web before what the loop was busy with has left the span: the closed loop brings it back.
    back = again + round(0.8 / CYCLE_S)
    assert np.max(np.abs(tension[back : back + 50] - 80.0)) < 2.0
    warnings = result_of(folder).all_warnings()
    assert any("axis 1 follows the ratio of speeds: the twin" in warning for warning in warnings)
    assert any("tension loop closed again" in warning for warning in warnings)
    assert gone(path)


def test_a_bench_that_is_stopped_has_its_drives_stopped_by_the_supervisor(tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS, safety={"cycle_timeout_s": 1.0})
    process = start(path)
    folder = wait_for_frames(path, 500)
    os.kill(process.pid, signal.SIGSTOP)
    deadline_s = time.monotonic() + 30.0
    log = folder / "supervisor.log"
    while "emergency stop: no heartbeat" not in log.read_text() and time.monotonic() < deadline_s:
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGCONT)
    process.communicate(timeout=60)
    assert process.returncode == 3
    result = result_of(folder)
    assert "emergency stop (COB-ID 001h)" in result.faults[0].text
    assert len(result.faults) == 1
    assert gone(path)
