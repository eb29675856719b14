"""Devices for the tests of the fieldbus."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.buses import KernelBus
from tests.canopen.device_under_test import DeviceUnderTest, Direct, DriveUnderTest, Wire


@pytest.fixture(params=["direct", pytest.param("kernel", marks=pytest.mark.vcan)])
def wire(request: pytest.FixtureRequest) -> Iterator[Direct | Wire]:
    """What is between test and device: nothing and, with `-m vcan`, the kernel's bus."""
    made = Direct() if request.param == "direct" else Wire(KernelBus())
    yield made
    made.close()


@pytest.fixture
def dut(tmp_path: Path, wire: Direct | Wire) -> DeviceUnderTest:
    """A device in OPERATIONAL."""
    return DeviceUnderTest(tmp_path, wire=wire).started()


@pytest.fixture
def drive(tmp_path: Path, wire: Direct | Wire) -> DriveUnderTest:
    """The simulated servo drive in PRE-OPERATIONAL."""
    return DriveUnderTest(tmp_path / "stored.json", wire).booted()
