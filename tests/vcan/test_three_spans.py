"""The line of three spans on the kernel's bus, on two CAN controllers of one wire, and in one process without a bus:
the bits of the embedded bus.

HILBENCH_VCAN and HILBENCH_CAN name the interfaces, HILBENCH_EMBEDDED_RUN the folder with the run on the embedded bus.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.vcan.test_two_controllers import bench, stand

from hilbench.results.recording import read_recording
from hilbench.results.run_folder import RunFolder

pytestmark = pytest.mark.vcan

CONFIG = Path(__file__).with_name("three_spans.yaml")


def assert_is_that_of_the_embedded_bus(runs: Path) -> None:
    [embedded] = Path(os.environ["HILBENCH_EMBEDDED_RUN"]).glob("three_spans-*")
    [run] = runs.iterdir()
    expected, found = (read_recording(RunFolder(folder).recording) for folder in (embedded, run))
    assert list(found.channels) == list(expected.channels)
    assert len(found) >= 300
    assert np.ptp(np.asarray(found["E2_true_Pa"])) > 1e9
    assert [name for name in found.channels if not np.array_equal(found[name], expected[name])] == []


@pytest.mark.parametrize("where", ["on the kernel's bus", "in one process"])
def test_every_signal(where: str, tmp_path: Path) -> None:
    how = ["--in-process"] if where == "in one process" else ["--bus", f"socketcan:{os.environ['HILBENCH_VCAN']}"]
    command = [sys.executable, "-m", "hilbench", "run", str(CONFIG), "--no-report", "--out", str(tmp_path / "runs")]
    done = subprocess.run([*command, *how], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert_is_that_of_the_embedded_bus(tmp_path / "runs")


@pytest.mark.skipif("HILBENCH_CAN" not in os.environ, reason="no two CAN controllers on one wire")
def test_every_signal_with_the_hardware_on_a_controller_of_its_own(tmp_path: Path) -> None:
    with stand(CONFIG, tmp_path):
        process = bench(CONFIG, tmp_path)
        out, _ = process.communicate(timeout=1800.0)
    assert process.returncode == 0, out
    assert_is_that_of_the_embedded_bus(tmp_path / "runs")
