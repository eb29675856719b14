"""The master's drive object against the simulated drive, PDO by PDO, and against drives that misbehave."""

from math import nan, pi

import pytest
from tests.cia402.stand_in import CYCLE_S, EDS, DriveUnderTest

from hilbench.canopen.eds import load_eds
from hilbench.cia402.configuration import SETPOINT_OBJECTS, DriveSettings, RpdoCopy, default_reader
from hilbench.cia402.drive import Drive, DriveGoal
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import State
from hilbench.cia402.units import DriveUnits
from hilbench.errors import BenchFaultError, UnusableInputError

RPM = 2.0 * pi / 60.0


def settings(mode: OperationMode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY, **changes: object) -> DriveSettings:
    return DriveSettings("axis 1", 1, mode, CYCLE_S, **changes)  # type: ignore[arg-type]


class Loop:
    """A drive object and a simulated drive, their PDOs handed over once per cycle."""

    def __init__(self, chosen: DriveSettings | None = None) -> None:
        self.chosen = chosen or settings()
        self.slave = DriveUnderTest()
        self.slave.write(0x6060, self.chosen.mode)
        od = load_eds(EDS, 1)
        self.drive = Drive(self.chosen, od)
        self.drive.units = DriveUnits.from_objects(default_reader(od))
        self.target = SETPOINT_OBJECTS[self.chosen.mode]
        self.received = True
        self.answering = True
        self.sent = self.drive.encode()

    def frames(self) -> dict[int, bytes]:
        if not self.answering:
            return {}
        return {
            pdo.cob_id: pdo.pack([self.slave.read(each.index) for each in pdo.variables])
            for pdo in self.drive.pdos.tpdos
        }

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.drive.decode(self.frames())
            self.sent = self.drive.encode()
            if self.received:
                controlword, target = self.drive.pdos.rpdo.unpack(self.sent[0].data)
                self.slave.write(0x6040, controlword)
                self.slave.write(self.target, target)
            self.slave.cycle()

    def go(self, goal: DriveGoal, most: int = 500) -> int:
        self.drive.request(goal)
        for count in range(most):
            self.cycle()
            if self.drive.reached:
                return count
        pytest.fail(f"{goal} not reached in {most} cycles, in {self.drive.feedback.state}")


def test_up_run_and_down_with_feedback_in_si_units() -> None:
    loop = Loop()
    assert loop.go(DriveGoal.ENABLED) <= 5
    loop.drive.setpoint = 75.0
    loop.cycle(100)
    feedback = loop.drive.feedback
    assert feedback.velocity_rad_s == pytest.approx(75.0, abs=1e-4)
    before_rad = feedback.position_rad
    loop.cycle(10)
    assert feedback.position_rad - before_rad == pytest.approx(75.0 * 10 * CYCLE_S, rel=1e-4)
    assert feedback.fresh
    loop.go(DriveGoal.DISABLED)
    assert feedback.state is State.SWITCH_ON_DISABLED
    assert abs(feedback.velocity_rad_s) < 5 * RPM


def test_torque_drive_without_a_velocity_pdo() -> None:
    loop = Loop(settings(OperationMode.CYCLIC_SYNCHRONOUS_TORQUE, has_velocity=False))
    loop.go(DriveGoal.ENABLED)
    loop.drive.setpoint = -1.5
    loop.cycle(10)
    assert loop.drive.feedback.torque_Nm == pytest.approx(-1.5)
    assert loop.drive.feedback.velocity_rad_s == pytest.approx(loop.slave.port.velocity_rad_s, rel=0.5)
    assert len(loop.drive.pdos.tpdos) == 1


def test_position_drive_does_not_move_when_enabled() -> None:
    loop = Loop(settings(OperationMode.CYCLIC_SYNCHRONOUS_POSITION))
    loop.slave.port.position_rad = 40_000.0  # the 32-bit counter has wrapped
    loop.slave.cycle()
    loop.cycle(2)
    loop.drive.setpoint = loop.drive.feedback.position_rad
    loop.go(DriveGoal.ENABLED)
    loop.cycle(5)
    assert loop.slave.port.position_rad == pytest.approx(40_000.0, abs=1e-4)
    loop.drive.setpoint += 0.01
    loop.cycle(20)
    assert loop.slave.port.position_rad == pytest.approx(40_000.01, abs=1e-4)


def test_position_is_unwrapped() -> None:
    loop = Loop()
    loop.slave.port.position_rad = (2**31 - 1000) * 2.0 * pi / 2**20
    loop.slave.cycle()
    loop.go(DriveGoal.ENABLED)
    start_rad = loop.drive.feedback.position_rad
    loop.drive.setpoint = 10.0
    loop.cycle(200)
    assert loop.drive.feedback.position_rad - start_rad == pytest.approx(200 * CYCLE_S * 10.0, rel=0.05)


def test_target_is_zero_until_enabled_and_after() -> None:
    loop = Loop()
    loop.drive.setpoint = 50.0
    loop.cycle(3)
    assert loop.slave.read(0x60FF) == 0
    loop.go(DriveGoal.ENABLED)
    loop.cycle(20)
    assert loop.slave.read(0x60FF) > 0
    loop.go(DriveGoal.QUICK_STOP)
    assert loop.slave.read(0x60FF) == 0
    assert loop.drive.feedback.state is State.SWITCH_ON_DISABLED


def test_quick_stop_where_the_drive_stays_in_it_is_reached_at_standstill() -> None:
    loop = Loop()
    loop.slave.write(0x605A, 6)
    loop.go(DriveGoal.ENABLED)
    loop.drive.setpoint = 50.0
    loop.cycle(50)
    loop.go(DriveGoal.QUICK_STOP)
    assert loop.drive.feedback.state is State.QUICK_STOP_ACTIVE
    assert abs(loop.drive.feedback.velocity_rad_s) <= 5 * RPM
    loop.go(DriveGoal.ENABLED)


@pytest.mark.parametrize("goal", [DriveGoal.QUICK_STOP, DriveGoal.DISABLED, DriveGoal.COAST])
def test_a_disabled_drive_is_never_enabled_on_the_way_down(goal: DriveGoal) -> None:
    loop = Loop()
    for controlword in (0x06, 0x07):
        loop.slave.controlword(controlword)
    seen = set()
    loop.drive.request(goal)
    for _ in range(10):
        loop.cycle()
        seen.add(loop.slave.drive.state)
    assert loop.drive.reached
    assert State.OPERATION_ENABLED not in seen


def test_fault_is_told_with_its_code_and_the_drive_stays_down() -> None:
    loop = Loop()
    loop.go(DriveGoal.ENABLED)
    loop.slave.write(0x2001, 0x7300)
    loop.drive.decode({0x81: bytes([0x00, 0x73, 0x21, 0, 0, 0, 0, 0])})
    with pytest.raises(BenchFaultError, match=r"axis 1 \(node 1\).*FAULT REACTION ACTIVE.*000Fh.*7300h"):
        loop.cycle(2)
    loop.cycle(100)  # told once
    assert loop.drive.feedback.state is State.FAULT
    loop.go(DriveGoal.FAULT_RESET)
    loop.cycle(50)
    assert loop.drive.feedback.state is State.SWITCH_ON_DISABLED


def test_fault_reset_after_any_controlword() -> None:
    loop = Loop()
    loop.slave.write(0x2001, 0x7300)
    loop.slave.controlword(0x80)
    loop.slave.write(0x2001, 0x7300)
    assert loop.slave.drive.state is State.FAULT
    loop.go(DriveGoal.FAULT_RESET)


def test_enabling_a_faulted_drive_is_refused_at_once() -> None:
    loop = Loop()
    loop.slave.write(0x2001, 0x5441)
    loop.drive.request(DriveGoal.ENABLED)
    with pytest.raises(BenchFaultError, match="is in FAULT, wanted OPERATION ENABLED"):
        loop.cycle(2)


def test_hanging_names_state_goal_and_controlword() -> None:
    loop = Loop(settings(time_out_s=0.1))
    loop.cycle(3)
    loop.received = False
    loop.drive.request(DriveGoal.ENABLED)
    with pytest.raises(
        BenchFaultError, match=r"hung in SWITCH ON DISABLED for 0.1 s, wanted OPERATION ENABLED; controlword sent 0006h"
    ):
        loop.cycle(100)
    loop.received = True
    loop.cycle(20)
    assert loop.slave.drive.state is State.SWITCH_ON_DISABLED, "a drive that failed is not enabled later"


def test_a_silent_drive_times_out() -> None:
    loop = Loop(settings(time_out_s=0.1))
    loop.answering = False
    loop.drive.request(DriveGoal.ENABLED)
    with pytest.raises(BenchFaultError, match="no statusword"):
        loop.cycle(100)
    assert not loop.drive.feedback.fresh
    assert loop.drive.feedback.powered, "an unknown state must not count as power off"


def test_leaving_enabled_by_itself_is_told() -> None:
    loop = Loop()
    loop.go(DriveGoal.ENABLED)
    loop.slave.write(0x6040, 0x00)
    loop.received = False
    with pytest.raises(BenchFaultError, match="left OPERATION ENABLED, is in SWITCH ON DISABLED"):
        loop.cycle(3)


@pytest.mark.parametrize("value", [nan, 1e9])
def test_impossible_set_points_are_refused(value: float) -> None:
    loop = Loop()
    loop.go(DriveGoal.ENABLED)
    loop.drive.setpoint = value
    with pytest.raises(BenchFaultError, match="set point"):
        loop.cycle()


def test_forked_workers_carry_the_same_data() -> None:
    loop = Loop(settings(copies=(RpdoCopy(0x211),)))
    loop.cycle(2)
    assert [frame.can_id for frame in loop.sent] == [0x201, 0x211]
    assert loop.sent[0].data == loop.sent[1].data


def test_a_mirroring_drive_listens_and_sends_nothing() -> None:
    drive = Drive(settings(listens_to=0x201, tpdo_type=None), load_eds(EDS, 17))
    assert drive.pdos.rpdo.cob_id == 0x201
    assert drive.pdos.tpdos == ()


def test_mode_without_a_cyclic_set_point_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="mode of operation 6, expected one of 3, 9, 4, 10, 8"):
        Loop(settings(OperationMode.HOMING))


def test_eds_that_lacks_a_mapped_object_is_refused() -> None:
    od = load_eds(EDS, 1)
    del od[0x6077]
    with pytest.raises(UnusableInputError, match="axis 1: the EDS lacks 6077h"):
        Drive(settings(), od)
