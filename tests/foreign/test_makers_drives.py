"""npm's canopen as the master of simulated drives from makers' EDS files (../shared/eds), on a virtual bus."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from math import pi
from pathlib import Path

import pytest
from tests.cia402.stand_in import EDS as OWN
from tests.foreign.foreign_station import ForeignStation, foreign_station, with_node_id

from hilbench import SimulatedDrive
from hilbench.can.adapter import PythonCanLink
from hilbench.can.python_can import can

NODE = 5
FILES = [
    path
    for path in sorted(Path(__file__).parents[3].glob("shared/eds/*"))
    if "[6040]" in path.read_text(errors="replace")
]
pytestmark = pytest.mark.skipif(shutil.which("npm") is None, reason="Node.js with npm is not installed")
_channels = count()
SET_POINT, REACHED, ACKNOWLEDGED = 0x10, 0x0400, 0x1000


@contextmanager
def driven(eds: Path, folder: Path, node: int | None = NODE) -> Iterator[tuple[SimulatedDrive, ForeignStation]]:
    """The drive of a file, and the station that knows the file; the station is there first."""
    file = folder / "device.eds"
    file.write_text(with_node_id(eds.read_text(errors="replace"), NODE), encoding="ascii", errors="replace")
    channel = f"makers-{next(_channels)}"

    def bus() -> can.BusABC:
        return can.Bus(interface="virtual", channel=channel)

    with (
        foreign_station(PythonCanLink(bus(), channel), NODE, file) as station,
        SimulatedDrive(eds, node, bus(), serial_number=None if node else 0x8000_0002) as drive,
    ):
        yield drive, station


class Master:
    """What somebody writes on top of the station to move a drive: objects by SDO, the commands of CiA 402."""

    def __init__(self, station: ForeignStation) -> None:
        self.station = station

    def write(self, index: int, value: int, size: int, sub: int = 0) -> None:
        self.station.download(index, sub, value.to_bytes(size, "little", signed=value < 0))

    def read(self, index: int, sub: int = 0) -> int:
        return int.from_bytes(self.station.upload(index, sub), "little", signed=True)

    @property
    def status(self) -> int:
        return self.read(0x6041) & 0xFFFF

    def command(self, word: int) -> None:
        self.write(0x6040, word, 2)

    def enable(self, mode: int) -> None:
        self.write(0x6060, mode, 1)
        for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            self.command(word)
            until(lambda state=state: self.status & 0x6F == state)  # type: ignore[misc]
        assert self.read(0x6061) == mode

    def disable(self) -> None:
        self.command(0x00)
        until(lambda: self.status & 0x4F == 0x40)


def until(holds: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 20.0
    while not holds():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@pytest.mark.skipif(not FILES, reason="the makers' EDS files are not here")
@pytest.mark.parametrize("eds", FILES, ids=lambda path: path.stem)
def test_it_drives_a_drive_of_another_maker(eds: Path, tmp_path: Path) -> None:
    """Boot-up, identity, each mode that the file has and that moves by SDO, PDO, heartbeat, EMCY and fault reset."""
    with driven(eds, tmp_path) as (drive, station):
        station.event("heartbeat", state=0)
        master = Master(station)
        assert station.upload(0x1018, 1) == int(drive.read(0x1018, 1)).to_bytes(4, "little")  # type: ignore[call-overload]
        tried = [mode for mode in drive.modes if mode in MODES]
        assert tried
        for mode in tried:
            master.enable(mode)
            MODES[mode](master, drive)
            master.disable()
        by_pdo(station, drive)
        master.write(0x1017, 20, 2)
        for service, state in (("stopNode", 4), ("startNode", 5)):  # changes of state are told, and 5 may be known
            station.nmt(service)
            station.event("heartbeat", state=state)
        drive.fault(0x8611)
        assert station.event("emergency", code=0x8611)["register"] & 0x01
        until(lambda: master.status & 0x4F == 0x08)
        master.command(0x80)
        assert station.event("emergency", code=0)["register"] == 0
        until(lambda: master.status & 0x4F == 0x40)


def profile_position(master: Master, drive: SimulatedDrive) -> None:
    """A turn by the set-point handshake, and half a turn back, relative."""
    turn = round(2.0 * pi / drive.position_unit_rad)
    start = drive.position_turns
    for target, flags, turns in ((master.read(0x6064) + turn, 0x00, 1.0), (-turn // 2, 0x40, 0.5)):
        master.write(0x607A, target, 4)
        master.command(0x0F | flags | SET_POINT)
        until(lambda: bool(master.status & ACKNOWLEDGED))
        master.command(0x0F | flags)
        until(lambda: master.status & (ACKNOWLEDGED | REACHED) == REACHED)
        until(lambda wanted=start + turns: abs(drive.position_turns - wanted) < 0.01)  # type: ignore[misc]


def profile_velocity(master: Master, drive: SimulatedDrive) -> None:
    """There and back; a halt stops it."""
    for sign in (1, -1):
        master.write(0x60FF, sign * 200, 4)
        until(lambda wanted=sign * 200: abs(master.read(0x606C) - wanted) <= 25)  # type: ignore[misc]
        until(lambda: bool(master.status & REACHED))
    master.command(0x010F)
    until(lambda: abs(drive.velocity_rpm) < 0.5 and bool(master.status & REACHED))
    master.write(0x60FF, 0, 4)


def profile_torque(master: Master, drive: SimulatedDrive) -> None:
    """A hundredth of the rated torque speeds it up, and back."""
    before = drive.velocity_rpm
    master.write(0x6071, 10, 2)
    until(lambda: drive.velocity_rpm > before + 10.0)
    assert drive.torque_Nm > 0.0
    master.write(0x6071, 0, 2)


def homing(master: Master, drive: SimulatedDrive) -> None:
    """Method 35: home is here, once what another mode has left turning stands still."""
    until(lambda: abs(drive.velocity_rpm) < 0.05)
    master.write(0x6098, 35, 1)
    master.command(0x1F)
    until(lambda: master.status & 0x3400 == 0x1400)
    assert abs(master.read(0x6064)) <= 3, "no home offset"


MODES: dict[int, Callable[[Master, SimulatedDrive], None]] = {
    1: profile_position,
    3: profile_velocity,
    4: profile_torque,
    6: homing,
}


def by_pdo(station: ForeignStation, drive: SimulatedDrive) -> None:
    """READY TO SWITCH ON and back by the file's own RPDO with a controlword, seen in the file's own TPDO1."""
    station.nmt("startNode")
    rpdo = int(drive.read(0x1400, 1)) & 0x7FF  # type: ignore[call-overload]
    tpdo = int(drive.read(0x1800, 1)) & 0x7FF  # type: ignore[call-overload]
    for word, state in ((0x06, 0x21), (0x00, 0x40)):
        station.write_pdo(rpdo, {"6040": word})
        for _ in range(3):
            station.sync()
        until(lambda state=state: status_in(station, tpdo) & 0x6F == state)  # type: ignore[misc]


def status_in(station: ForeignStation, tpdo: int) -> int:
    return next(value for name, value in station.event("pdo", cob_id=tpdo)["values"].items() if "tatus" in name)


def test_it_finds_a_drive_without_a_node_id_and_gives_it_one(tmp_path: Path) -> None:
    with driven(OWN, tmp_path, node=None) as (drive, station):
        vendor, product, revision = (int(drive.read(0x1018, sub)) for sub in (1, 2, 3))  # type: ignore[call-overload]
        found = station.find(vendor, product, revision)
        assert found is not None
        assert found["serialNumber"] == 0x8000_0002
        station.give_node_id(NODE)
        station.event("heartbeat", state=0)
        assert drive.node_id == NODE
        assert Master(station).read(0x1018, 4) & 0xFFFFFFFF == 0x8000_0002
        assert station.find(vendor, product, revision) is None
