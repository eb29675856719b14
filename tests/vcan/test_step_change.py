"""The step-change experiment on the kernel's bus, as a user runs it, with candump beside it.

HILBENCH_VCAN names the interface, HILBENCH_EMBEDDED_RUN the folder of the same run on the embedded bus.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import dropwhile
from pathlib import Path

import numpy as np
import pytest

from hilbench.results.recording import read_recording
from hilbench.results.run_folder import RunFolder

pytestmark = pytest.mark.vcan

CONFIG = Path(__file__).with_name("step_change.yaml")


@contextmanager
def candump(channel: str, log: Path) -> Iterator[None]:
    """can-utils' candump as a witness, where it is installed, with a receive buffer that holds a whole run."""
    if shutil.which("candump") is None:
        yield
        return
    with log.open("wb") as file:
        witness = subprocess.Popen(["candump", "-L", "-r", "16777216", channel], stdout=file)
        try:
            yield
        finally:
            witness.send_signal(signal.SIGINT)
            witness.wait(30)


@pytest.fixture(scope="module")
def run_and_witness(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunFolder, Path]:
    """The run folder, and candump's log of the same time."""
    folder = tmp_path_factory.mktemp("step")
    channel = os.environ["HILBENCH_VCAN"]
    command = [sys.executable, "-m", "hilbench", "run", str(CONFIG), "--bus", f"socketcan:{channel}"]
    with candump(channel, folder / "witness.log"):
        done = subprocess.run(
            [*command, "--no-report", "--out", str(folder / "runs")], capture_output=True, text=True, check=False
        )
    assert done.returncode == 0, done.stdout + done.stderr
    [run] = (folder / "runs").iterdir()
    return RunFolder(run), folder / "witness.log"


def test_every_signal_is_that_of_the_embedded_bus(run_and_witness: tuple[RunFolder, Path]) -> None:
    [embedded] = Path(os.environ["HILBENCH_EMBEDDED_RUN"]).glob("step_change-*")
    expected, found = read_recording(RunFolder(embedded).recording), read_recording(run_and_witness[0].recording)
    assert list(found.channels) == list(expected.channels)
    assert len(found) > 500
    assert np.ptp(np.asarray(found["E_true_Pa"])) > 1e9
    different = [name for name in found.channels if not np.array_equal(found[name], expected[name])]
    assert different == []


def frames(log: Path) -> list[str]:
    """Identifier and data of each line of a candump log."""
    return [line.split()[2] for line in log.read_text().splitlines()]


@pytest.mark.skipif(shutil.which("candump") is None, reason="can-utils is not installed")
def test_candump_has_the_frames_of_the_trace(run_and_witness: tuple[RunFolder, Path]) -> None:
    run, witness = run_and_witness
    # Before the bus is the bench's, and there is a run to keep a trace of, it asks whether its nodes are there already.
    seen = dropwhile(lambda frame: frame.endswith("#4000100000000000"), frames(witness))
    ours, theirs = Counter(frames(run.trace)), Counter(seen)
    assert ours - theirs == Counter(), "in trace.log alone"
    assert theirs - ours == Counter(), "seen by candump alone"
