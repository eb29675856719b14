"""The event loop of a device host, on a link that plays a script: what goes out together, and when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from tests.canopen.device_under_test import eds_text
from tests.canopen.wall_clock import WallClock

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.canopen import clock as clock_module
from hilbench.canopen import host as host_module
from hilbench.canopen.clock import Clock, MonotonicClock, SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.host import DeviceHost
from hilbench.errors import BusError

SYNC = Frame(0x080, b"")
CYCLE_NS = 2_000_000


class ScriptedLink:
    """Gives one list of frames per `receive`, keeps what is sent batch by batch."""

    channel = "script"
    dropped = 0
    controller = ControllerState.ERROR_ACTIVE

    def __init__(self) -> None:
        self.batches: list[list[tuple[int, str]]] = []
        self.incoming: list[Frame] = []
        self.lost = False
        self.passes: set[int] = set()

    def send(self, frames: Sequence[Frame]) -> None:
        self.batches.append([(frame.can_id, frame.data.hex()) for frame in frames])

    def receive(self, timeout_s: float) -> list[Frame]:
        if self.lost:
            raise BusError("script: the bus is lost")
        frames, self.incoming = self.incoming, []
        return frames

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        self.passes = {identifier for identifier, _ in identifiers or ()}

    def fileno(self) -> int:
        raise NotImplementedError

    def close(self) -> None:
        pass


class RecordingApplication:
    """Notes its calls; reports an error of device 1 while the plant of the cycle `fails_in` advances."""

    listens_to = frozenset({0x181})

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.device: Device | None = None
        self.fails = False
        self.ticked_s = 0.0

    def before_sync(self, behind: int) -> None:
        self.calls.append("before")

    def after_sync(self) -> None:
        self.calls.append("after")
        if self.fails and self.device is not None:
            self.fails = False
            self.device.emergency(0x8611, 0x20)

    def on_frame(self, frame: Frame) -> None:
        self.calls.append(f"{frame.can_id:X}")

    def tick(self, duration_s: float) -> None:
        self.ticked_s += duration_s


class HostUnderTest:
    def __init__(self, folder: Path, clock: Clock, wall: WallClock) -> None:
        path = folder / "device.eds"
        path.write_text(eds_text(), encoding="ascii")
        self.wall = wall
        self.link = ScriptedLink()
        self.application = RecordingApplication()
        self.devices = [Device(load_eds(path, node), node, clock) for node in (1, 2)]
        self.application.device = self.devices[0]
        for device in self.devices:
            device.cell(0x1017).value = 10
        self.host = DeviceHost(self.link, self.devices, clock, self.application)
        self.host.run(lambda: True)
        self.serve(Frame(0, b"\x01\x00"))
        self.link.batches.clear()
        self.application.calls.clear()

    def serve(self, *frames: Frame, wall_ms: float = 0.0) -> list[list[tuple[int, str]]]:
        """Frames come after so much wall time; the batches that go out."""
        self.wall.ns += int(wall_ms * 1e6)
        self.link.incoming = list(frames)
        self.host.serve(0.0)
        batches, self.link.batches = self.link.batches, []
        return batches


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> WallClock:
    made = WallClock()
    monkeypatch.setattr(clock_module, "time", made)
    monkeypatch.setattr(host_module, "time", made)
    return made


@pytest.fixture
def lockstep(tmp_path: Path, wall: WallClock) -> HostUnderTest:
    return HostUnderTest(tmp_path, SyncClock(CYCLE_NS, stall_s=1.0), wall)


@pytest.fixture
def realtime(tmp_path: Path, wall: WallClock) -> HostUnderTest:
    return HostUnderTest(tmp_path, MonotonicClock(), wall)


def test_boot_up_of_all_devices_goes_first(tmp_path: Path, wall: WallClock) -> None:
    path = tmp_path / "device.eds"
    path.write_text(eds_text(), encoding="ascii")
    link = ScriptedLink()
    clock = MonotonicClock()
    devices = [Device(load_eds(path, node), node, clock) for node in (1, 2)]
    DeviceHost(link, devices, clock, RecordingApplication()).run(lambda: True)
    assert link.batches == [[(0x701, "00"), (0x702, "00")]]


def test_all_that_belongs_to_a_sync_is_one_batch(lockstep: HostUnderTest) -> None:
    lockstep.serve(SYNC)
    for _ in range(4):
        [batch] = lockstep.serve(SYNC)
        assert [can_id for can_id, _ in batch] == [0x181, 0x182]
    [batch] = lockstep.serve(SYNC)  # 10 ms after the first: heartbeats are due
    assert sorted(can_id for can_id, _ in batch) == [0x181, 0x182, 0x701, 0x702]


def test_application_is_called_around_the_sampling(lockstep: HostUnderTest) -> None:
    lockstep.serve(SYNC, Frame(0x181, b""))
    assert lockstep.application.calls == ["before", "after", "181"]


def test_lockstep_holds_what_arises_after_the_batch(lockstep: HostUnderTest) -> None:
    lockstep.serve(SYNC)
    lockstep.application.fails = True
    [batch] = lockstep.serve(SYNC)
    assert 0x081 not in [can_id for can_id, _ in batch]
    assert lockstep.serve() == []
    [batch] = lockstep.serve(SYNC)
    assert batch[0] == (0x081, "1186210000000000")


def test_realtime_sends_it_at_once(realtime: HostUnderTest) -> None:
    realtime.serve(SYNC)
    realtime.application.fails = True
    batches = realtime.serve(SYNC, wall_ms=2)
    assert (0x081, "1186210000000000") in batches[1]


def test_sdo_answers_do_not_wait_for_sync(lockstep: HostUnderTest) -> None:
    lockstep.serve(SYNC)
    assert lockstep.serve(Frame(0x601, bytes.fromhex("4000100000000000"))) == [[(0x581, "4300100092010200")]]


@pytest.mark.parametrize("wall_ms", [0.01, 2.0, 300.0])
def test_lockstep_says_the_same_in_every_cycle_however_fast_the_machine(
    lockstep: HostUnderTest, wall_ms: float
) -> None:
    lockstep.serve(wall_ms=7 * wall_ms)
    heartbeats = []
    for cycle in range(30):
        batches = lockstep.serve(SYNC, wall_ms=wall_ms) + lockstep.serve(wall_ms=wall_ms)
        heartbeats += [cycle for batch in batches for can_id, _ in batch if can_id == 0x701]
    assert heartbeats == [5, 10, 15, 20, 25]


def test_dead_master_is_noticed_by_the_wall_clock(lockstep: HostUnderTest) -> None:
    for node_id in (1, 2):
        lockstep.serve(Frame(0x600 + node_id, bytes.fromhex("2316100164007f00")))  # 1016h: the master, 100 ms
    lockstep.serve(SYNC, Frame(0x77F, b"\x05"))
    lockstep.serve(wall_ms=999)
    assert lockstep.devices[0].nmt_state == 5
    batches = lockstep.serve(wall_ms=102)
    assert (0x081, "3081117f00000000") in [frame for batch in batches for frame in batch]
    assert lockstep.devices[0].nmt_state == 127


def test_application_ticks_only_while_no_sync_runs_and_loses_no_time(realtime: HostUnderTest) -> None:
    for _ in range(10):
        realtime.serve(wall_ms=2.7)
    assert realtime.application.ticked_s == pytest.approx(0.027, abs=0.003)
    ticked_s = realtime.application.ticked_s
    for _ in range(10):
        realtime.serve(SYNC, wall_ms=2)
    assert realtime.application.ticked_s == ticked_s


def test_lost_bus_ends_the_loop(realtime: HostUnderTest) -> None:
    realtime.link.lost = True
    with pytest.raises(BusError):
        realtime.host.run(lambda: False)


def test_sync_clock(wall: WallClock) -> None:
    clock = SyncClock(CYCLE_NS, stall_s=1.0)
    clock.tick()
    start = clock.now_ns()
    wall.ns += 900_000_000
    assert clock.now_ns() == start
    clock.tick()
    assert clock.now_ns() == start + CYCLE_NS
    wall.ns += 1_500_000_000
    assert clock.now_ns() == start + CYCLE_NS + 500_000_000
    clock.tick()
    assert clock.now_ns() == start + 2 * CYCLE_NS + 500_000_000


MASTER, SIGN_OF_LIFE = 0x77F, Frame(0x77F, b"\x05")


@pytest.fixture
def kept(tmp_path: Path, wall: WallClock) -> HostUnderTest:
    return HostUnderTest(tmp_path, SyncClock(CYCLE_NS, stall_s=1.0, kept_by=MASTER), wall)


def test_time_stands_still_while_the_master_says_that_it_is_alive(kept: HostUnderTest) -> None:
    kept.serve(SYNC)
    for _ in range(200):  # 20 s, in which no heartbeat of the devices is due and nothing moves
        assert kept.serve(SIGN_OF_LIFE, wall_ms=100) == []
    assert kept.application.ticked_s == 0.0
    answers = [kept.serve(SYNC, wall_ms=2) for _ in range(10)]
    heartbeats = [batch for batches in answers for batch in batches if batch[0][0] == 0x701]
    assert len(heartbeats) == 2  # every 10 ms of ten cycles of 2 ms: as if there had been no pause


@pytest.mark.parametrize(
    ("frame", "why"), [(None, "silent"), (Frame(0x77F, b"\x7f"), "PRE-OPERATIONAL"), (Frame(0x77E, b"\x05"), "another")]
)
def test_a_master_that_does_not_say_so_is_noticed(kept: HostUnderTest, frame: Frame | None, why: str) -> None:
    kept.serve(SYNC)
    for _ in range(15):
        kept.serve(*([frame] if frame else []), wall_ms=100)
    assert kept.application.ticked_s > 0.0, why
    ticked_s = kept.application.ticked_s
    for _ in range(5):  # it comes back: time goes by the wall clock until the next SYNC
        kept.serve(SIGN_OF_LIFE, wall_ms=100)
    assert kept.application.ticked_s > ticked_s


def test_an_error_passive_controller_is_told_by_every_device(lockstep: HostUnderTest) -> None:
    """CiA 301: EMCY 8120h, error register generic and communication; 0000h when it is over."""
    lockstep.link.controller = ControllerState.ERROR_PASSIVE
    batches = lockstep.serve(SYNC)
    told = {can_id: data for batch in batches for can_id, data in batch if can_id in (0x081, 0x082)}
    assert told == {0x081: "2081110000000000", 0x082: "2081110000000000"}
    assert not [can_id for batch in lockstep.serve(SYNC) for can_id, _ in batch if can_id in (0x081, 0x082)]
    lockstep.link.controller = ControllerState.ERROR_ACTIVE
    over = [data[:4] for batch in lockstep.serve(SYNC) for can_id, data in batch if can_id in (0x081, 0x082)]
    assert over == ["0000", "0000"]


def test_receives_what_its_devices_are_configured_for(lockstep: HostUnderTest) -> None:
    passes = lockstep.link.passes
    assert {0x000, 0x001, 0x080, 0x181, 0x201, 0x202, 0x601, 0x602} <= passes
    assert not passes & {0x182, 0x603, 0x703}
    lockstep.serve(Frame(0x601, bytes.fromhex("2316100164000300")))  # 1016h sub 1: watch node 3 for 100 ms
    assert lockstep.link.passes - passes == {0x703}
