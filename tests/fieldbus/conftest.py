"""Devices for the tests of the fieldbus."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.fieldbus.device_under_test import DeviceUnderTest


@pytest.fixture
def dut(tmp_path: Path) -> DeviceUnderTest:
    """A device in OPERATIONAL."""
    return DeviceUnderTest(tmp_path).started()
