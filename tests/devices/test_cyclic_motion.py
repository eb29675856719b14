"""A simulated drive under the SYNC of a master that differentiates its position; the clock is set by hand."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from tests.canopen.device_under_test import HandClock
from tests.cia402.every_mode import INCREMENTS, eds_file

from hilbench.apps.devices.application import SimulatedNode
from hilbench.apps.devices.simulation import hosted, simulated_axes
from hilbench.cia402.state_machine import State

CSP, CSV = 8, 9
MODE, CONTROLWORD, INTERPOLATION_PERIOD, FOLLOWING_ERROR_WINDOW = 0x6060, 0x6040, 0x60C2, 0x6065
POSITION, TARGET_POSITION, TARGET_VELOCITY = 0x6064, 0x607A, 0x60FF


class Driven:
    """A drive of an EDS file in OPERATION ENABLED, and a SYNC of any period."""

    def __init__(self, folder: Path, mode: int, period_s: float) -> None:
        self._clock = HandClock()
        self.node: SimulatedNode = simulated_axes(eds_file(folder), 5, self._clock)[0]
        _, self._application = hosted([self.node], self._clock)
        self._period_ns = round(period_s * 1e9)
        self.write(MODE, mode)
        self.write(INTERPOLATION_PERIOD, -4, 2)
        self.write(INTERPOLATION_PERIOD, round(period_s * 1e4), 1)
        for word in (0x06, 0x07, 0x0F):
            self.write(CONTROLWORD, word)
            self.sync()
        assert self.node.drive.state is State.OPERATION_ENABLED

    def write(self, index: int, value: int, sub: int = 0) -> None:
        self.node.device.cell(index, sub).write(value)

    def read(self, index: int) -> int:
        return int(self.node.device.cell(index).value)

    def sync(self) -> int:
        """One SYNC; the position that is sampled at it."""
        self._clock.ns += self._period_ns
        self._application.before_sync(0)
        position = self.read(POSITION)
        self._application.after_sync()
        return position


@pytest.mark.parametrize("period_s", [0.002, 0.0025])
def test_a_master_that_interpolates_positions_sees_no_following_error_at_constant_speed(
    tmp_path: Path, period_s: float
) -> None:
    drive = Driven(tmp_path, CSP, period_s)
    drive.write(FOLLOWING_ERROR_WINDOW, 100)
    counts = round(20 * INCREMENTS * period_s)  # 20 turns/s: 200 of them in a millisecond
    target, errors = drive.read(POSITION), []
    for step in range(600):
        target += round(counts * min(1.0, step / 300))
        drive.write(TARGET_POSITION, target)
        drive.sync()
        errors.append(int(drive.node.drive.firmware.following_error.value))
    assert drive.node.drive.state is State.OPERATION_ENABLED
    assert max(map(abs, errors[500:])) <= 0.01 * counts


@pytest.mark.parametrize("period_s", [0.0005, 0.002, 0.0025, 0.01 / 3])
def test_a_master_that_differentiates_positions_sees_even_motion_at_any_sync_period(
    tmp_path: Path, period_s: float
) -> None:
    drive = Driven(tmp_path, CSV, period_s)
    drive.write(TARGET_VELOCITY, 600)  # rpm
    positions = [drive.sync() for _ in range(600)]
    steps = [b - a for a, b in pairwise(positions)][400:]
    assert sum(steps) / len(steps) == pytest.approx(10 * INCREMENTS * period_s, rel=0.01)
    assert max(steps) - min(steps) <= max(2, 0.02 * 10 * INCREMENTS * period_s)
