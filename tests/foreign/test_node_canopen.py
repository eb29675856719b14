"""npm's canopen, an implementation of its own, as the other side of the simulated drive and of the device runtime.

It runs in a Node.js process; its frames go over the in-process bus (and, marked `vcan`, over the kernel's).
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.buses import Bus
from tests.canopen.device_under_test import SECTIONS, SERVO_EDS, U32, eds_text, record, var
from tests.cia402.stand_in import SimulatedDrives, served
from tests.foreign.foreign_station import OWN_NODE, PACKAGES, ForeignStation, Refused, foreign_station, with_node_id

from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds

pytestmark = pytest.mark.skipif(shutil.which("npm") is None, reason="Node.js with npm is not installed")

NODE = 5
RPM = 10_000
LONG = bytes(range(256)) * 7
SDO_SERVER = record(
    0x1200,
    "SDO server parameter",
    var("COB-ID client to server", U32, "ro", "$NODEID+0x600"),
    var("COB-ID server to client", U32, "ro", "$NODEID+0x580"),
)


@contextmanager
def station_and_device(bus: Bus, eds: str, folder: Path) -> Iterator[tuple[ForeignStation, Device]]:
    """The foreign station, and a device of this EDS; a drive when the EDS describes one."""
    file = folder / "device.eds"
    file.write_text(with_node_id(eds, NODE), encoding="ascii")
    clock = MonotonicClock(stall_s=1.0)
    device = Device(load_eds(file, NODE), NODE, clock)
    application = SimulatedDrives([device] if device.has(0x6502) else [])
    link = bus.open_link()
    with foreign_station(link, NODE, file) as station, served(bus.open_link(), [device], clock, application):
        station.event("heartbeat", state=0)
        yield station, device


@pytest.fixture
def drive(bus: Bus, tmp_path: Path) -> Iterator[ForeignStation]:
    """The station beside the simulated servo drive."""
    with station_and_device(bus, SERVO_EDS.read_text(encoding="ascii"), tmp_path) as (station, _):
        yield station


@pytest.fixture
def plain(bus: Bus, tmp_path: Path) -> Iterator[tuple[ForeignStation, Device]]:
    """The station beside a device with texts and data of any length that may be written."""
    with station_and_device(bus, eds_text(SECTIONS | SDO_SERVER), tmp_path) as pair:
        yield pair


def test_the_package_is_here() -> None:
    assert (PACKAGES / "canopen").exists(), "npm's canopen is missing: make .cache/node-canopen/.installed"


def test_it_reads(drive: ForeignStation) -> None:
    assert drive.upload(0x1000) == (0x00020192).to_bytes(4, "little")
    assert drive.upload(0x1018, 2) == (0x0402).to_bytes(4, "little")
    assert drive.upload(0x6041) == (0x0250).to_bytes(2, "little")
    assert drive.upload(0x1008) == b"hilbench servo"
    assert drive.upload(0x1008, block=True) == b"hilbench servo"


def test_it_writes(drive: ForeignStation) -> None:
    drive.download(0x605A, 0, (6).to_bytes(2, "little"))
    drive.download(0x1016, 2, (127 << 16 | 500).to_bytes(4, "little"))
    assert drive.upload(0x605A) == (6).to_bytes(2, "little")
    assert drive.upload(0x1016, 2) == (127 << 16 | 500).to_bytes(4, "little")


@pytest.mark.parametrize(
    ("index", "data", "abort"),
    [
        (0x1000, bytes(4), 0x06010002),
        (0x5FFF, bytes(4), 0x06020000),
        (0x605A, bytes(4), 0x06070012),
        (0x605A, b"\x63\0", 0x06090031),
    ],
)
def test_it_understands_refusals(drive: ForeignStation, index: int, data: bytes, abort: int) -> None:
    with pytest.raises(Refused) as refused:
        drive.download(index, 0, data)
    assert refused.value.code == abort


@pytest.mark.parametrize("length", [1, 4, 5, 7, 8, 889, 890, len(LONG)])
@pytest.mark.parametrize("block", [False, True], ids=["segmented", "block"])
def test_data_of_any_length_go_there_and_back(plain: tuple[ForeignStation, Device], length: int, block: bool) -> None:
    station, device = plain
    station.download(0x2003, 0, LONG[:length], block=block)
    assert device.cell(0x2003).value == LONG[:length]
    assert station.upload(0x2003, block=block) == LONG[:length]


def test_it_starts_stops_and_resets_by_nmt_and_hears_the_heartbeat(drive: ForeignStation) -> None:
    drive.download(0x1017, 0, (20).to_bytes(2, "little"))
    drive.event("heartbeat", node=NODE, state=127)
    for service, state in (("startNode", 5), ("stopNode", 4), ("enterPreOperational", 127), ("resetNode", 0)):
        drive.nmt(service)
        drive.event("heartbeat", node=NODE, state=state)


def test_it_hears_emergencies(drive: ForeignStation) -> None:
    drive.download(0x2001, 0, (0x7300).to_bytes(2, "little"))
    received = drive.event("emergency", code=0x7300)
    assert (received["cob_id"], received["register"], received["info"]) == (0x085, 0x21, "0000000000")
    assert drive.upload(0x1003, 1) == (0x7300).to_bytes(4, "little")
    drive.download(0x6040, 0, (0x80).to_bytes(2, "little"))
    received = drive.event("emergency", code=0)
    assert (received["register"], received["info"]) == (0, "0073000000")


def test_its_heartbeat_is_watched(drive: ForeignStation) -> None:
    drive.download(0x1016, 1, (OWN_NODE << 16 | 300).to_bytes(4, "little"))
    drive.nmt("startNode")
    drive.heartbeat(50)
    drive.heartbeat(0)
    assert drive.event("emergency", code=0x8130)["info"] == "7e00000000"
    drive.heartbeat(50)
    assert drive.event("emergency", code=0)["info"] == "3081000000"
    drive.heartbeat(0)


def test_it_drives_by_pdo(drive: ForeignStation) -> None:
    drive.download(0x6060, 0, (9).to_bytes(1, "little"))
    drive.download(0x6083, 0, (20_000 * RPM).to_bytes(4, "little"))
    drive.nmt("startNode")
    for controlword, status in ((0x06, 0x0231), (0x07, 0x0233), (0x0F, 0x1237)):
        drive.command(controlword, 300 * RPM)
        drive.sync()
        drive.sync()
        assert drive.event("pdo", cob_id=0x185)["values"]["Statusword"] == status, hex(status)
    for _ in range(1000):
        drive.sync()
        if drive.event("pdo", cob_id=0x285)["values"]["Velocity actual value"] > 299 * RPM:
            break
    else:
        pytest.fail("the drive has not reached its velocity")
