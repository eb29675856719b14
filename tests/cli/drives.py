"""Two simulated drives, nodes 5 and 6, on an embedded bus of their own, and the command that reads and writes them."""

from __future__ import annotations

import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench, nobody_else

from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present

EDS = Path(__file__).parents[2] / "eds" / "hilbench_servo.eds"


@pytest.fixture(scope="module")
def bus() -> Iterator[str]:
    """The bus while they are there."""
    name = f"embedded:{uuid.uuid4().hex[:12]}"
    arguments = [str(EDS), "--node", "5", "--count", "2", "--bus", name]
    running = subprocess.Popen([sys.executable, "-m", "hilbench", "simulate-drive", *arguments])
    link = open_link(BusAddress.parse(name))
    assert any(len(present(link, [5, 6], 0.2)) == 2 for _ in range(300)), "the drives do not answer"
    link.close()
    with nobody_else():
        yield name
    running.terminate()
    running.wait(timeout=20)


def sdo(bus: str, command: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """`hilbench sdo` on that bus."""
    return hilbench("sdo", command, "--bus", bus, "--eds", str(EDS), *map(str, arguments))
