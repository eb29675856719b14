"""What tests of several parts share."""

from __future__ import annotations

import pytest
from tests.buses import Bus, KernelBus

from hilbench.can.memory import MemoryBus


@pytest.fixture(params=["memory", pytest.param("kernel", marks=pytest.mark.vcan)])
def bus(request: pytest.FixtureRequest) -> Bus:
    """The bus inside the process and, with `-m vcan`, the kernel's."""
    return MemoryBus() if request.param == "memory" else KernelBus()
