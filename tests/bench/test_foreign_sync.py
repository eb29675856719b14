"""Simulated hardware under a master that is not the bench: its SYNC has a period of its own, jitters, stops."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import pi
from pathlib import Path

import pytest
from tests.bench.whole_runs import config
from tests.canopen.wall_clock import WallClock

from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus
from hilbench.canopen import clock as clock_module
from hilbench.canopen import host as host_module
from hilbench.canopen.host import DeviceHost
from hilbench.hardware.simulation import hardware
from hilbench.runs.config import load

MS = 1_000_000
SYNC = Frame(0x080, b"")
POSITION_RAD, VELOCITY_RAD_S = 2 * pi / (1 << 20), 2 * pi / 60 * 1e-4
RPM = 10_000
#: 6064h is that of a sample time of the drive's loop (1 ms), two beside that of the SYNC at most where it is locked.
NEAREST_S = 2.5e-3


@dataclass
class ForeignMaster:
    """A master on the hardware's bus, and the machine's clock."""

    host: DeviceHost
    bus: MemoryBus
    wall: WallClock
    #: Time (s), position (rad) and velocity (rad/s) of node 1 at each SYNC that was answered.
    answers: list[tuple[float, float, float]] = field(default_factory=list)
    heartbeats_s: list[float] = field(default_factory=list)
    emergencies: list[int] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.link = self.bus.open_link()
        self.link.set_filters(None)
        self._position: float | None = None
        self._synced_s = 0.0

    @property
    def now_s(self) -> float:
        return self.wall.ns * 1e-9

    def wait(self, ms: float) -> None:
        """Time passes; the hardware's loop turns every half a millisecond or so."""
        end_ns = self.wall.ns + round(ms * MS)
        while self.wall.ns < end_ns:
            self.wall.ns = min(end_ns, self.wall.ns + MS // 2)
            self.host.serve(0.0)
            self._hear()

    def send(self, *frames: Frame) -> None:
        self.link.send(frames)
        self.host.serve(0.0)
        self._hear()

    def sync(self) -> None:
        self._synced_s = self.now_s
        self.send(SYNC)

    def write(self, index: int, value: int, size: int, sub: int = 0, node: int = 1) -> None:
        command = 0x2F - 4 * (size - 1)
        data = bytes([command]) + index.to_bytes(2, "little") + bytes([sub])
        self.send(Frame(0x600 + node, data + (value & (1 << 8 * size) - 1).to_bytes(4, "little")))

    def command(self, controlword: int, rpm: float) -> None:
        """RPDO1: controlword and target velocity."""
        self.send(Frame(0x201, controlword.to_bytes(2, "little") + round(rpm * RPM).to_bytes(4, "little", signed=True)))

    def turn(self, rpm: float, sync: Callable[[], None]) -> None:
        """Start node 1 and bring it to this speed, in profile velocity mode."""
        self.write(0x6060, 3, 1)
        self.send(Frame(0, b"\x01\x01"))
        for controlword in (0x06, 0x07, 0x0F):
            self.command(controlword, rpm)
            sync()
            sync()

    def _hear(self) -> None:
        for frame in self.link.receive(0.0):
            if frame.can_id == 0x181:
                self._position = int.from_bytes(frame.data[4:8], "little", signed=True) * POSITION_RAD
            elif frame.can_id == 0x281 and self._position is not None:
                velocity = int.from_bytes(frame.data[:4], "little", signed=True) * VELOCITY_RAD_S
                self.answers.append((self._synced_s, self._position, velocity))
            elif frame.can_id == 0x701 and frame.data != b"\0":
                self.heartbeats_s.append(self.now_s)
            elif frame.can_id == 0x081:
                self.emergencies.append(int.from_bytes(frame.data[:2], "little"))


@pytest.fixture
def master(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ForeignMaster:
    """Of the hardware of a bench of 2 ms, as `hilbench simulate-hardware` runs it when nobody paces it."""
    wall = WallClock()
    monkeypatch.setattr(clock_module, "time", wall)
    monkeypatch.setattr(host_module, "time", wall)
    bench, _ = load(config(tmp_path, pace="realtime", hardware={"sensors": {}}))
    bus = MemoryBus()
    made = ForeignMaster(DeviceHost(bus.open_link(), *hardware(bench)), bus, wall)
    made.host.boot()
    made.wait(20)
    return made


def integral_rad(answers: list[tuple[float, float, float]]) -> float:
    """Of the velocity over the time of the SYNCs, by trapezoids."""
    return sum((later[0] - earlier[0]) * (earlier[2] + later[2]) / 2 for earlier, later in pairwise(answers))


def assert_position_fits_the_velocity(answers: list[tuple[float, float, float]]) -> None:
    assert len(answers) > 10
    fastest = max(abs(velocity) for _, _, velocity in answers)
    assert fastest > 10.0
    found = answers[-1][1] - answers[0][1]
    assert found == pytest.approx(integral_rad(answers), abs=fastest * NEAREST_S)


@pytest.mark.parametrize("period_ms", [0.5, 1, 2, 2.5, 5, 10, 20, 20.15])
def test_position_is_the_integral_of_the_velocity_whatever_the_period_of_sync(
    master: ForeignMaster, period_ms: float
) -> None:
    def cycle() -> None:
        master.wait(period_ms)
        master.sync()

    master.turn(300, cycle)
    start_s = master.now_s
    while master.now_s < start_s + 0.8:
        cycle()
    master.command(0x0F, -200)
    while master.now_s < start_s + 1.6:
        cycle()
    assert_position_fits_the_velocity(master.answers)


@pytest.mark.parametrize("period_ms", [50, 150, 400])
def test_a_sync_that_comes_seldom_sees_the_position_of_its_time(master: ForeignMaster, period_ms: float) -> None:
    def cycle() -> None:
        master.wait(period_ms)
        master.sync()

    master.turn(300, cycle)
    master.wait(1000)  # at its speed: trapezoids know nothing of a ramp between two SYNCs
    master.answers.clear()
    for _ in range(11):
        cycle()
    assert_position_fits_the_velocity(master.answers)


def test_an_even_sync_sees_even_steps_although_it_jitters(master: ForeignMaster) -> None:
    """A real drive's clock locks to SYNC: what comes 0.4 ms late is not sampled 0.4 ms late."""
    late = random.Random(5)
    start_ns = master.wall.ns

    def cycle() -> None:
        cycles = (master.wall.ns - start_ns) // (2 * MS) + 1
        master.wait((start_ns + cycles * 2 * MS - master.wall.ns) / MS + late.uniform(0.0, 0.4))
        master.sync()

    master.turn(300, cycle)
    for _ in range(1500):
        cycle()
    steps = [later[1] - earlier[1] for earlier, later in pairwise(master.answers[500:])]
    speed = master.answers[-1][2]
    assert steps == [pytest.approx(0.002 * speed, rel=0.01)] * len(steps)


def test_lost_syncs_lose_no_time(master: ForeignMaster) -> None:
    lost = random.Random(7)

    def cycle() -> None:
        master.wait(10)
        if lost.random() > 0.3:
            master.sync()

    master.turn(300, cycle)
    for _ in range(400):
        cycle()
    assert_position_fits_the_velocity(master.answers)


def test_a_bunch_of_syncs_that_is_read_late_loses_no_time(master: ForeignMaster) -> None:
    """The process of the hardware was not scheduled for some cycles."""

    def cycle() -> None:
        master.wait(2)
        master.sync()

    master.turn(300, cycle)
    for number in range(600):
        if number % 50:
            cycle()
            continue
        for _ in range(7):
            master.wall.ns += 2 * MS
            master.link.send([SYNC])
        master.send()
        master.answers.clear()
    for _ in range(40):
        cycle()
    assert_position_fits_the_velocity(master.answers)


@pytest.mark.parametrize("period_ms", [2.5, 10.0 / 3.0])
def test_a_master_that_differentiates_positions_sees_even_motion_though_its_sync_is_not_ours(
    master: ForeignMaster, period_ms: float
) -> None:
    def cycle() -> None:
        master.wait(period_ms)
        master.sync()

    master.turn(300, cycle)
    for _ in range(600):
        cycle()
    steps = [later[1] - earlier[1] for earlier, later in pairwise(master.answers[-200:])]
    assert steps == [pytest.approx(period_ms * 1e-3 * master.answers[-1][2], rel=0.02)] * len(steps)


def test_the_drive_goes_on_turning_while_no_sync_comes(master: ForeignMaster) -> None:
    def cycle() -> None:
        master.wait(5)
        master.sync()

    master.turn(300, cycle)
    for _ in range(200):
        cycle()
    before = master.answers[-1]
    master.wait(700)
    master.sync()
    after = master.answers[-1]
    assert after[0] - before[0] == pytest.approx(0.7)
    assert after[1] - before[1] == pytest.approx(0.7 * before[2], abs=before[2] * NEAREST_S)


def test_the_clock_of_the_drive_follows_that_of_the_master_where_both_may_be_right(master: ForeignMaster) -> None:
    """Quartz clocks differ by some 1e-5 to 1e-4: every SYNC sees the same whole number of sample times."""

    def cycle() -> None:
        master.wait(2 * 1.0002)
        master.sync()

    master.turn(300, cycle)
    for _ in range(6000):
        cycle()
    steps = [later[1] - earlier[1] for earlier, later in pairwise(master.answers[500:])]
    assert steps == [pytest.approx(0.002 * master.answers[-1][2], rel=0.01)] * len(steps)


@pytest.mark.parametrize("period_ms", [1, 5, 20])
def test_it_says_once_that_sync_has_another_period(
    master: ForeignMaster, period_ms: float, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(100):
        master.wait(period_ms)
        master.sync()
    said = capsys.readouterr().out.splitlines()
    assert said == [f"SYNC comes every {period_ms:g} ms, cycle_time_s is 2 ms: the simulated hardware goes by time"]


def test_it_says_nothing_when_sync_is_that_of_the_config(
    master: ForeignMaster, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in range(300):
        master.wait(2)
        if number % 40:
            master.sync()
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("period_ms", [None, 2, 10, 150], ids=["no SYNC", "2 ms", "10 ms", "150 ms"])
def test_heartbeats_come_by_time_whatever_sync_does(master: ForeignMaster, period_ms: float | None) -> None:
    master.send(Frame(0, b"\x01\x01"))
    written_s = master.now_s
    master.write(0x1017, 100, 2)
    while master.now_s < written_s + 2.0:
        master.wait(period_ms or 10)
        if period_ms:
            master.sync()
    expected = [written_s + 0.1 * number for number in range(1, 20)]
    assert master.heartbeats_s[:19] == [pytest.approx(time_s, abs=0.003) for time_s in expected]


def test_a_lost_master_is_noticed_in_its_time_though_another_goes_on_with_sync(master: ForeignMaster) -> None:
    master.write(0x1016, 0x7F << 16 | 200, 4, sub=1)
    master.send(Frame(0, b"\x01\x01"))
    master.send(Frame(0x77F, b"\x05"))
    heard_s = master.now_s
    while not master.emergencies:
        master.wait(20)
        master.sync()
        assert master.now_s < heard_s + 1.0
    assert master.emergencies == [0x8130]
    assert master.now_s == pytest.approx(heard_s + 0.2, abs=0.021)


@pytest.mark.parametrize("period_ms", [5, 20])
def test_a_position_target_is_reached_when_the_interpolation_period_is_over(
    master: ForeignMaster, period_ms: int
) -> None:
    """Cyclic synchronous position with 60C2h as the SYNC period: the motor moves evenly from target to target."""
    master.write(0x60C2, period_ms, 1, sub=1)
    master.write(0x60C2, -3, 1, sub=2)
    master.write(0x6060, 8, 1)
    for index, sub, value, size in (
        (0x1400, 1, 0x80000201, 4),
        (0x1600, 0, 0, 1),
        (0x1600, 1, 0x60400010, 4),
        (0x1600, 2, 0x607A0020, 4),
        (0x1600, 0, 2, 1),
        (0x1400, 1, 0x201, 4),
    ):
        master.write(index, value, size, sub=sub)
    master.send(Frame(0, b"\x01\x01"))

    def give(controlword: int, target: int) -> None:
        master.send(Frame(0x201, controlword.to_bytes(2, "little") + target.to_bytes(4, "little", signed=True)))
        master.sync()

    for controlword in (0x06, 0x07, 0x0F):
        give(controlword, 0)
        master.wait(period_ms)
    start = master.answers[-1][1]
    demands, speed = [], 20.0
    for number in range(1, 2000 // period_ms):
        give(0x0F, round((start + number * speed * period_ms * 1e-3) / POSITION_RAD))
        demands.append(master.answers[-1])
        master.wait(period_ms)
    assert_position_fits_the_velocity(demands)
    moving = [velocity for _, _, velocity in demands[-20:]]
    assert moving == [pytest.approx(speed, rel=1e-3)] * len(moving)


def test_a_set_point_that_comes_without_sync_acts_soon_however_seldom_sync_comes(master: ForeignMaster) -> None:
    def cycle() -> None:
        master.wait(400)
        master.sync()

    master.turn(100, cycle)
    for _ in range(3):
        cycle()
    master.wait(100)
    before = master.answers[-1][2]
    master.write(0x6084, 20_000 * RPM, 4)
    master.write(0x60FF, 0, 4)
    master.wait(40)
    master.sync()
    assert before == pytest.approx(100 * RPM * VELOCITY_RAD_S, rel=0.02)
    assert abs(master.answers[-1][2]) < 0.5 * before


def test_a_process_that_was_stopped_says_so_and_leaves_that_time_out(
    master: ForeignMaster, capsys: pytest.CaptureFixture[str]
) -> None:
    def cycle() -> None:
        master.wait(2)
        master.sync()

    master.turn(300, cycle)
    for _ in range(400):
        cycle()
    before = master.answers[-1]
    master.wall.ns += 30_000 * MS
    master.sync()
    assert master.answers[-1][1] - before[1] == pytest.approx(0.0, abs=0.01 * before[2])
    assert capsys.readouterr().out == "held up for 30.0 s: the simulated hardware stood still meanwhile\n"
