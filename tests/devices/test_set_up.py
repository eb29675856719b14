"""Set-up work with a drive by SDO: the master's side of CiA 402, against simulated drives of several EDS files."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from math import pi
from pathlib import Path

import pytest
from tests.cia402.every_mode import eds_file

from hilbench import SimulatedDrive
from hilbench.can.python_can import can
from hilbench.canopen.eds import load_eds
from hilbench.canopen.master import Master
from hilbench.cia402.configuration import read_units
from hilbench.cia402.manual import ManualDrive
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.set_up import Limits, SetUpDrive, usable
from hilbench.cia402.state_machine import State
from hilbench.errors import BenchFaultError, UnusableInputError

SERVO = Path(__file__).parents[2] / "eds" / "hilbench_servo.eds"
TURN_RAD = 2.0 * pi
_channels = count()


@contextmanager
def set_up(
    eds: Path, allowed: Limits | None = None, alive: Callable[[], None] = lambda: None
) -> Iterator[tuple[SimulatedDrive, SetUpDrive]]:
    """A simulated drive as node 5, and who sets it up."""
    channel = f"set-up-{next(_channels)}"
    with SimulatedDrive(eds, 5, can.Bus(interface="virtual", channel=channel)) as drive:
        master = Master(can.Bus(interface="virtual", channel=channel), 5.0)
        try:
            od = load_eds(eds, 5)
            master.add(5, od, "axis")
            master.wait_for_answer([5], 10.0)
            units = read_units(master, 5, od, {}, "axis")
            manual = ManualDrive(master, 5, "axis", units, 5.0, alive)
            yield drive, SetUpDrive(manual, eds.name, allowed or Limits())
        finally:
            master.close()


@pytest.fixture
def eds(tmp_path: Path) -> Path:
    return eds_file(tmp_path)


def test_it_moves_to_a_position_and_from_where_it_is(eds: Path) -> None:
    with set_up(eds) as (drive, by_hand):
        by_hand.move(0.5 * TURN_RAD, 20.0)
        assert drive.position_turns == pytest.approx(0.5, abs=0.01)
        by_hand.move(-0.25 * TURN_RAD, 20.0, relative=True)
        assert drive.position_turns == pytest.approx(0.25, abs=0.01)
        assert drive.read(0x6081) == 600  # as it was
        by_hand.drive.disable()
        assert drive.state is State.SWITCH_ON_DISABLED


def test_a_position_beyond_the_software_limit_is_refused_before_it_moves(eds: Path) -> None:
    with set_up(eds) as (drive, by_hand):
        drive.write(0x607D, -5000, 1)
        drive.write(0x607D, 5000, 2)
        with pytest.raises(UnusableInputError, match=r"6.28\d* rad, expected -3.14\d* to 3.14\d* rad \(607Dh\)"):
            by_hand.move(TURN_RAD, 5.0)
        assert drive.state is State.SWITCH_ON_DISABLED
        by_hand.move(0.4 * TURN_RAD, 20.0)


def test_speed_and_torque_stay_within_the_drives_objects_and_the_config() -> None:
    config = Limits(torque_Nm=0.5, torque_by="safety: limits: torque_Nm")
    with set_up(SERVO, config) as (drive, by_hand):
        with pytest.raises(UnusableInputError, match=r"1000 rad/s, expected at most 314.159 rad/s \(607Fh\)"):
            by_hand.turn(1000.0, 1.0)
        with pytest.raises(UnusableInputError, match=r"0.7 N·m, expected at most 0.5 N·m \(safety: "):
            by_hand.push(-0.7, 1.0, 10.0)
        assert drive.state is State.SWITCH_ON_DISABLED


def test_it_homes_by_a_method_and_says_when_that_fails(eds: Path) -> None:
    with set_up(eds) as (drive, by_hand):
        assert by_hand.home(35) == 35
        assert drive.read(0x6064) == pytest.approx(500, abs=5)  # 607Ch
        assert by_hand.home() == 35
        with pytest.raises(BenchFaultError, match=r"homing method 0 failed: statusword ....h, bit 13"):
            by_hand.home(0)


def test_it_turns_for_a_while_and_is_at_rest_after_it() -> None:
    with set_up(SERVO) as (drive, by_hand):
        by_hand.turn(10.0, 0.5)
        assert drive.position_turns > 0.1
        assert abs(drive.velocity_rpm) < 1.0
        assert drive.state is State.OPERATION_ENABLED
        by_hand.drive.quick_stop()
        assert drive.state is State.SWITCH_ON_DISABLED


def test_a_motor_that_gets_too_fast_under_torque_is_stopped(eds: Path) -> None:
    with set_up(eds) as (drive, by_hand):
        with pytest.raises(BenchFaultError, match=r"turns with .* rad/s, the limit is 3 rad/s"):
            by_hand.push(5.0, 60.0, 3.0)
        assert abs(drive.velocity_rpm) < 2.0
        by_hand.push(0.0, 0.1, 3.0)


@pytest.mark.parametrize(
    ("lacks", "mode", "said"),
    [
        (0x607A, OperationMode.PROFILE_POSITION, "607Ah is not in every_mode.eds"),
        (0x60FF, OperationMode.PROFILE_VELOCITY, "60FFh is not in every_mode.eds"),
        (0x6071, OperationMode.TORQUE, "6071h is not in every_mode.eds"),
        (0x6098, OperationMode.HOMING, "6098h is not in every_mode.eds"),
    ],
)
def test_what_a_drive_lacks_is_said_by_object(tmp_path: Path, lacks: int, mode: OperationMode, said: str) -> None:
    without_pdo = (0x1400, 0x1600) if lacks == 0x607A else ()
    with set_up(eds_file(tmp_path, lacks, *without_pdo)) as (_, by_hand):
        assert {of: bool(missing) for of, missing in usable(by_hand).items()} == {
            of: of is mode for of in usable(by_hand)
        }
        assert by_hand.lacking(mode) == [said]
        with pytest.raises(UnusableInputError, match=f"{said}: .* can't be used"):
            by_hand.needs(mode)


def test_a_mode_that_6502h_lacks_is_said() -> None:
    with set_up(SERVO) as (_, by_hand), pytest.raises(UnusableInputError, match="6502h is 3ACh, without bit 0"):
        by_hand.move(1.0, 1.0)


def test_a_fault_on_the_way_is_told_with_its_code() -> None:
    begun = threading.Event()
    with set_up(SERVO, alive=begun.set) as (drive, by_hand):
        failing = threading.Thread(target=lambda: (begun.wait(30.0), drive.fault(0x7310)))
        failing.start()
        with pytest.raises(BenchFaultError, match=r"OPERATION ENABLED.* 7310h$"):
            by_hand.turn(10.0, 60.0)
        failing.join()
        by_hand.drive.reset()
        assert drive.state is State.SWITCH_ON_DISABLED


def test_reserved_option_codes_are_refused_and_method_0_is_no_homing(eds: Path) -> None:
    from canopen.sdo import SdoAbortedError

    with SimulatedDrive(SERVO, 5, can.Bus(interface="virtual", channel=f"set-up-{next(_channels)}")) as drive:
        for index, code in ((0x605A, 9), (0x605B, 2), (0x605C, 2), (0x605D, 5), (0x605E, 5), (0x6007, 4), (0x605A, -1)):
            with pytest.raises(SdoAbortedError):
                drive.write(index, code)
    with set_up(eds) as (drive, _):
        drive.write(0x6098, 0)
        assert drive.read(0x6098) == 0
