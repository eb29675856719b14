"""Bench and simulated hardware on two CAN controllers of one wire, as at the stand.

HILBENCH_CAN names both, `can0,can1`: bench and twin are on the first, the drives on the second.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hilbench.apps.doctor.check_machine import measure_lateness
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load

pytestmark = [
    pytest.mark.vcan,
    pytest.mark.skipif("HILBENCH_CAN" not in os.environ, reason="no two CAN controllers on one wire"),
]

FOLDER = Path(__file__).parent
CLI = [sys.executable, "-m", "hilbench"]
END_S = 60.0


def controllers() -> tuple[str, str]:
    first, second = os.environ["HILBENCH_CAN"].split(",")
    return first, second


@contextmanager
def stand(config: Path, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The simulated hardware on the second controller, its process; the twin on the first."""
    first, second = controllers()
    pace = ["--pace", load(config)[0].pace]
    with (folder / "hardware.log").open("wb") as log:
        hardware, twin = (
            subprocess.Popen(
                [*CLI, command, str(config), "--bus", f"socketcan:{channel}", *pace],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
            for command, channel in (("simulate-hardware", second), ("twin", first))
        )
    try:
        yield hardware
    finally:
        for process in (hardware, twin):
            process.terminate()
        for process in (hardware, twin):
            process.wait(END_S)


def bench(config: Path, folder: Path) -> subprocess.Popen[str]:
    command = [*CLI, "run", str(config), "--bus", f"socketcan:{controllers()[0]}", "--no-start", "--no-report"]
    return subprocess.Popen(
        [*command, "--out", str(folder / "runs")], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


def run_folder(folder: Path) -> RunFolder:
    [made] = (folder / "runs").iterdir()
    return RunFolder(made)


def wait_for_syncs(folder: Path, process: subprocess.Popen[str], count: int) -> None:
    while not any(log.read_bytes().count(b" 080#") >= count for log in folder.glob("runs/*/trace.log")):
        assert process.poll() is None, process.communicate()[0]
        time.sleep(0.1)


def test_in_real_time_no_cycle_is_missed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = FOLDER / "realtime.yaml"
    with stand(config, tmp_path):
        process = bench(config, tmp_path)
        said, _ = process.communicate()
    assert process.returncode == 0, said
    folder = run_folder(tmp_path)
    timing = Result.read(folder.result).timing
    assert timing.jitter_us is not None
    late, bare = timing.jitter_us, measure_lateness(timing.cycle_us * 1e-6, 4.0)
    with capsys.disabled():
        print(
            f"\nreal time, bench on {controllers()[0]}, hardware on {controllers()[1]}: {timing.cycles} cycles of "
            f"{timing.cycle_us / 1000:g} ms, {timing.missed} missed, SYNC late by {late.p50:.0f} µs (p50), "
            f"{late.p99:.0f} µs (p99), {late.max:.0f} µs (max); a bare loop by {bare.p50_us:.0f}, {bare.p99_us:.0f}, "
            f"{bare.max_us:.0f} µs"
        )
    recording = read_recording(folder.recording)
    assert np.ptp(np.asarray(recording["v2_m_s"])) == pytest.approx(1.0, rel=0.05)
    assert np.max(np.diff(recording.time_s)) == pytest.approx(timing.cycle_us * 1e-6)


def test_a_controller_that_goes_down_is_the_safe_state_and_all_data_kept(tmp_path: Path) -> None:
    config = FOLDER / "two_controllers.yaml"
    _, second = controllers()
    with stand(config, tmp_path) as hardware:
        process = bench(config, tmp_path)
        wait_for_syncs(tmp_path, process, 300)
        subprocess.run(["ip", "link", "set", second, "down"], check=True)
        try:
            said, _ = process.communicate(timeout=END_S)
            ended = hardware.wait(END_S)
        finally:
            subprocess.run(["ip", "link", "set", second, "up"], check=True)
    assert process.returncode == 3, said
    assert ended == 3
    assert f"{second}: is down" in (tmp_path / "hardware.log").read_text()
    folder = run_folder(tmp_path)
    bench_fault, *unconfirmed = Result.read(folder.result).faults
    assert "no answer to SYNC from axis1 (node 1) (COB-ID 181h)" in bench_fault.text
    assert [fault.source for fault in unconfirmed] == ["safe state"]
    trace = [line.split()[2] for line in folder.trace.read_text().splitlines()]
    assert [frame for frame in trace if frame.startswith("201#")][-1].startswith("201#0200")  # quick stop
    # Every cycle from when the drives were enabled to the one that was not answered any more.
    recording = read_recording(folder.recording)
    assert np.diff(recording.time_s) == pytest.approx(0.002)
    answered = sum(frame.startswith("181#") for frame in trace)
    assert 200 < len(recording) <= answered
    assert recording.time_s[-1] == pytest.approx(bench_fault.time_s)
