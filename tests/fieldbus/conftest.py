"""Devices for the tests of the fieldbus."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.fieldbus.device_under_test import DeviceUnderTest, DriveUnderTest


@pytest.fixture
def dut(tmp_path: Path) -> DeviceUnderTest:
    """A device in OPERATIONAL."""
    return DeviceUnderTest(tmp_path).started()


@pytest.fixture
def drive(tmp_path: Path) -> DriveUnderTest:
    """The simulated servo drive in PRE-OPERATIONAL."""
    return DriveUnderTest(tmp_path / "stored.json").booted()
