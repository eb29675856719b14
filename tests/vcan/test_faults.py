"""What the fault matrix says of processes that are killed, and of an emergency stop, also holds on the kernel's bus.

The interface is named by HILBENCH_VCAN.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.vcan

MATRIX = Path(__file__).resolve().parents[2] / "tools" / "fault_matrix.py"


@pytest.mark.parametrize("fault", ["bench: kill -9", "hardware: kill -9", "emergency stop from a terminal"])
def test_a_row_of_the_matrix_holds(fault: str) -> None:
    bus = f"socketcan:{os.environ['HILBENCH_VCAN']}"
    command = [sys.executable, str(MATRIX), "--bus", bus, "--only", f"^{fault}$"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert f"| {fault} |" in done.stdout
    assert "| – | ✓ |" in done.stdout
