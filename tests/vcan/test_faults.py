"""What the fault matrix says of a bench that is killed also holds on the kernel's bus.

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


def test_a_bench_is_killed() -> None:
    bus = f"socketcan:{os.environ['HILBENCH_VCAN']}"
    command = [sys.executable, str(MATRIX), "--bus", bus, "--only", "^bench: kill -9"]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "| bench: kill -9 |" in done.stdout
    assert "| ✓ |" in done.stdout
