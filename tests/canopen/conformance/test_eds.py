"""EDS cases of the conformance test: an independent checker."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EDS = Path(__file__).parents[3] / "eds"


@pytest.mark.case("EDS 1")
@pytest.mark.parametrize("name", ["hilbench_servo.eds", "hilbench_servo_dual.eds", "hilbench_virtual_io.eds"])
def test_checker_has_nothing_to_say(name: str) -> None:
    command = [sys.executable, "-c", "from dcf.cli import main; main()", "-n", "5", str(EDS / name)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
