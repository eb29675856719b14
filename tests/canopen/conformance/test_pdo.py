"""PDO cases of the conformance test: communication and mapping parameters by SDO, frames by their bytes.

TPDO1 of the drive maps statusword (0250h: switch-on disabled), torque and position.
"""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

START, STOP, ENTER_PRE_OPERATIONAL = 1, 2, 128
REMOTE = 0x40000000
INVALID, NO_REMOTE_REQUEST = 0x80000000, 0x40000000
TPDO1, TPDO2, RPDO1 = 0x185, 0x285, 0x205
AT_REST = (TPDO1, "5002000000000000")
MOVED = (TPDO1, "5002000007000000")
VELOCITY = (TPDO2, "00000000")

UNSUPPORTED, NOT_MAPPABLE, TOO_LONG = 0x06010000, 0x06040041, 0x06040042


def configure_tpdo1(
    drive: DriveUnderTest, kind: int, *, inhibit: int = 0, event_ms: int = 0, start: int = 0, remote: bool = False
) -> None:
    """The procedure: invalid, parameters, valid. Inhibit time in units of 100 µs."""
    cob_id = TPDO1 | (0 if remote else NO_REMOTE_REQUEST)
    assert drive.write(0x1800, 1, INVALID | cob_id, 4) == 0
    assert drive.write(0x1800, 2, kind, 1) == 0
    assert drive.write(0x1800, 3, inhibit, 2) == 0
    assert drive.write(0x1800, 5, event_ms, 2) == 0
    assert drive.write(0x1800, 6, start, 1) == 0
    assert drive.write(0x1800, 1, cob_id, 4) == 0
    # TPDO2 keeps out of it.
    assert drive.write(0x1801, 1, INVALID | NO_REMOTE_REQUEST | TPDO2, 4) == 0


def move(drive: DriveUnderTest, position: int) -> None:
    drive.device.cell(0x6064).value = position


def request_remotely(drive: DriveUnderTest, state: int) -> list[tuple[int, str]]:
    """What a remote request brings when the TPDO allows it."""
    configure_tpdo1(drive, 1, remote=True)
    drive.nmt(state)
    drive.after(0)
    return drive.send(REMOTE | TPDO1)


def change_values(drive: DriveUnderTest, state: int, kind: int = 254) -> list[tuple[int, str]]:
    """What an event-driven TPDO sends at the start, without a change, and after one."""
    configure_tpdo1(drive, kind)
    drive.nmt(state)
    sent = drive.after(1) + drive.after(1000)
    move(drive, 7)
    return sent + drive.after(1)


def let_time_pass(drive: DriveUnderTest, state: int) -> list[tuple[int, str]]:
    """What an event timer of 100 ms sends in 1 s, nothing changing, looked at each ms."""
    configure_tpdo1(drive, 254, event_ms=100)
    drive.nmt(state)
    return [frame for _ in range(1000) for frame in drive.after(1)]


def sync_cyclically(drive: DriveUnderTest, state: int) -> list[list[tuple[int, str]]]:
    """What six SYNCs bring, with every third asked for."""
    configure_tpdo1(drive, 3)
    drive.nmt(state)
    return [drive.sync() for _ in range(6)]


def sync_acyclically(drive: DriveUnderTest, state: int) -> list[list[tuple[int, str]]]:
    """What SYNCs bring with type 0: at first, without a change, and after one."""
    configure_tpdo1(drive, 0)
    drive.nmt(state)
    sent = [drive.sync(), drive.sync()]
    move(drive, 7)
    assert drive.after(1) == []
    return [*sent, drive.sync(), drive.sync()]


def sync_from_start_value(drive: DriveUnderTest, state: int) -> list[int]:
    """The counter values of the SYNCs that bring a TPDO, every second one asked for from 4 on."""
    assert drive.write(0x1019, 0, 10, 1) == 0
    configure_tpdo1(drive, 2, start=4)
    drive.nmt(state)
    return [counter for counter in range(1, 11) if drive.sync(bytes((counter,))) == [AT_REST]]


# -- communication parameters ----------------------------------------------------------------------------


@case("PDO 1")
def test_scan_of_rpdos(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 14 01 00000000") == "4300140105020000"
    assert drive.sdo("40 01 14 01 00000000") == "4301140105030080"
    assert drive.sdo("40 02 14 01 00000000") == "4302140105040080"
    assert drive.sdo("40 03 14 01 00000000") == "4303140105050080"
    assert drive.sdo("40 04 14 01 00000000") == "8004140100000206"


@case("PDO 2")
def test_scan_of_tpdos(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 18 01 00000000") == "4300180185010040"
    assert drive.sdo("40 01 18 01 00000000") == "4301180185020040"
    assert drive.sdo("40 02 18 01 00000000") == "43021801850300c0"
    assert drive.sdo("40 03 18 01 00000000") == "43031801850400c0"
    assert drive.sdo("40 04 18 01 00000000") == "8004180100000206"


# -- NMT state operational -------------------------------------------------------------------------------


@case("PDO 3")
def test_remote_request_in_operational(drive: DriveUnderTest) -> None:
    assert request_remotely(drive, START) == [AT_REST]
    configure_tpdo1(drive, 1, remote=False)
    assert drive.send(REMOTE | TPDO1) == []


@case("PDO 4")
@pytest.mark.parametrize("kind", [254, 255])
def test_event_driven_in_operational(drive: DriveUnderTest, kind: int) -> None:
    assert change_values(drive, START, kind) == [AT_REST, MOVED]


@case("PDO 4")
def test_inhibit_time_holds_a_change_back(drive: DriveUnderTest) -> None:
    configure_tpdo1(drive, 254, inhibit=50)  # 5 ms
    drive.nmt(START)
    assert drive.after(0) == [AT_REST]
    move(drive, 7)
    assert drive.after(4.9) == []
    assert drive.after(0.1) == [MOVED]


@case("PDO 5")
def test_event_timer_in_operational(drive: DriveUnderTest) -> None:
    assert let_time_pass(drive, START) == [AT_REST] * 10


@case("PDO 6")
def test_cyclic_in_operational(drive: DriveUnderTest) -> None:
    assert sync_cyclically(drive, START) == [[], [], [AT_REST], [], [], [AT_REST]]


@case("PDO 7")
def test_acyclic_in_operational(drive: DriveUnderTest) -> None:
    assert sync_acyclically(drive, START) == [[AT_REST], [], [MOVED], []]


@case("PDO 8")
def test_start_value_in_operational(drive: DriveUnderTest) -> None:
    assert sync_from_start_value(drive, START) == [4, 6, 8, 10]


# -- NMT state stopped -----------------------------------------------------------------------------------


@case("PDO 9")
def test_remote_request_in_stopped(drive: DriveUnderTest) -> None:
    assert request_remotely(drive, STOP) == []


@case("PDO 10")
def test_event_driven_in_stopped(drive: DriveUnderTest) -> None:
    assert change_values(drive, STOP) == []


@case("PDO 11")
def test_event_timer_in_stopped(drive: DriveUnderTest) -> None:
    assert let_time_pass(drive, STOP) == []


@case("PDO 12")
def test_cyclic_in_stopped(drive: DriveUnderTest) -> None:
    assert sync_cyclically(drive, STOP) == [[]] * 6


@case("PDO 13")
def test_acyclic_in_stopped(drive: DriveUnderTest) -> None:
    assert sync_acyclically(drive, STOP) == [[]] * 4


@case("PDO 14")
def test_start_value_in_stopped(drive: DriveUnderTest) -> None:
    assert sync_from_start_value(drive, STOP) == []


# -- NMT state pre-operational ---------------------------------------------------------------------------


@case("PDO 15")
def test_remote_request_in_pre_operational(drive: DriveUnderTest) -> None:
    assert request_remotely(drive, ENTER_PRE_OPERATIONAL) == []


@case("PDO 16")
def test_event_driven_in_pre_operational(drive: DriveUnderTest) -> None:
    assert change_values(drive, ENTER_PRE_OPERATIONAL) == []


@case("PDO 17")
def test_event_timer_in_pre_operational(drive: DriveUnderTest) -> None:
    assert let_time_pass(drive, ENTER_PRE_OPERATIONAL) == []


@case("PDO 18")
def test_cyclic_in_pre_operational(drive: DriveUnderTest) -> None:
    assert sync_cyclically(drive, ENTER_PRE_OPERATIONAL) == [[]] * 6


@case("PDO 19")
def test_acyclic_in_pre_operational(drive: DriveUnderTest) -> None:
    assert sync_acyclically(drive, ENTER_PRE_OPERATIONAL) == [[]] * 4


@case("PDO 20")
def test_start_value_in_pre_operational(drive: DriveUnderTest) -> None:
    assert sync_from_start_value(drive, ENTER_PRE_OPERATIONAL) == []


# -- mapping parameters ----------------------------------------------------------------------------------


@case("PDO 21")
@pytest.mark.parametrize(
    ("mapping", "entries"),
    [
        (0x1600, [0x60400010, 0x60FF0020]),
        (0x1601, []),
        (0x1602, []),
        (0x1603, []),
        (0x1A00, [0x60410010, 0x60770010, 0x60640020]),
        (0x1A01, [0x606C0020]),
        (0x1A02, []),
        (0x1A03, []),
    ],
)
def test_default_mapping_names_objects_of_that_length(drive: DriveUnderTest, mapping: int, entries: list[int]) -> None:
    assert drive.read(mapping, 0) == len(entries)
    assert [drive.read(mapping, sub) for sub in range(1, 9)] == entries + [0] * (8 - len(entries))
    for entry in entries:
        data = drive.upload(entry >> 16, entry >> 8 & 0xFF)
        assert isinstance(data, bytes)
        assert 8 * len(data) == entry & 0xFF


@case("PDO 22")
def test_mapping_procedure(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 00 14 01 05020080") == "6000140100000000"
    assert drive.sdo("2f 00 16 00 00000000") == "6000160000000000"
    assert drive.sdo("23 00 16 01 2000ff60") == "6000160100000000"
    assert drive.sdo("23 00 16 02 10004060") == "6000160200000000"
    assert drive.sdo("2f 00 16 00 02000000") == "6000160000000000"
    assert drive.sdo("23 00 14 01 05020000") == "6000140100000000"
    drive.nmt(START)
    drive.send(RPDO1, "1027000006 00")
    drive.sync()
    assert drive.sdo("40 ff 60 00 00000000") == "43ff600010270000"
    assert drive.sdo("40 40 60 00 00000000") == "4b40600006000000"


@case("PDO 23")
def test_mapping_without_the_procedure(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 00 14 01 05020080") == "6000140100000000"
    assert drive.sdo("23 00 16 01 10004060") == "8000160100000106"
    assert drive.sdo("23 00 18 01 850100c0") == "6000180100000000"
    assert drive.sdo("23 00 1a 01 10004160") == "80001a0100000106"


@case("PDO 24")
def test_mapping_of_a_valid_pdo(drive: DriveUnderTest) -> None:
    assert drive.sdo("2f 00 16 00 00000000") == "8000160000000106"
    assert drive.sdo("23 00 16 01 10004060") == "8000160100000106"
    assert drive.sdo("2f 00 1a 00 00000000") == "80001a0000000106"
    assert drive.sdo("23 00 1a 01 10004160") == "80001a0100000106"


def open_mapping(drive: DriveUnderTest, communication: int, cob_id: int) -> None:
    assert drive.write(communication, 1, INVALID | cob_id, 4) == 0
    assert drive.write(communication + 0x200, 0, 0, 1) == 0


MAPPINGS = pytest.mark.parametrize(
    ("communication", "cob_id", "entry"),
    [(0x1400, 0x205, 0x60FF0020), (0x1800, 0x40000185, 0x60640020)],
    ids=["RPDO1", "TPDO1"],
)


@case("PDO 25")
@MAPPINGS
def test_too_many_objects(drive: DriveUnderTest, communication: int, cob_id: int, entry: int) -> None:
    open_mapping(drive, communication, cob_id)
    assert drive.write(communication + 0x200, 0, 9, 1) == TOO_LONG
    assert drive.write(communication + 0x200, 9, entry, 4) == 0x06090011


@case("PDO 26")
@MAPPINGS
def test_objects_too_long(drive: DriveUnderTest, communication: int, cob_id: int, entry: int) -> None:
    open_mapping(drive, communication, cob_id)
    for sub in (1, 2, 3):
        assert drive.write(communication + 0x200, sub, entry, 4) == 0
    assert drive.write(communication + 0x200, 0, 3, 1) == TOO_LONG
    assert drive.write(communication + 0x200, 0, 2, 1) == 0


CONTROLWORD, STATUSWORD, PROFILE_UNIT, PLACEHOLDER = 0x60400010, 0x60410010, 0x60A90020, 0x00060010


@case("PDO 27")
def test_process_output_into_an_rpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1400, RPDO1)
    assert drive.write(0x1600, 1, CONTROLWORD, 4) == 0


@case("PDO 28")
def test_process_input_into_an_rpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1400, RPDO1)
    assert drive.write(0x1600, 1, STATUSWORD, 4) == NOT_MAPPABLE


@case("PDO 29")
def test_not_mappable_into_an_rpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1400, RPDO1)
    assert drive.write(0x1600, 1, 0x10170010, 4) == NOT_MAPPABLE


@case("PDO 30")
def test_process_input_into_a_tpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1800, NO_REMOTE_REQUEST | TPDO1)
    assert drive.write(0x1A00, 1, STATUSWORD, 4) == 0


@case("PDO 31")
def test_process_output_into_a_tpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1800, NO_REMOTE_REQUEST | TPDO1)
    assert drive.write(0x1A00, 1, CONTROLWORD, 4) == NOT_MAPPABLE


@case("PDO 32")
def test_not_mappable_into_a_tpdo(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1800, NO_REMOTE_REQUEST | TPDO1)
    assert drive.write(0x1A00, 1, PROFILE_UNIT, 4) == NOT_MAPPABLE


@case("PDO 33")
def test_dummy_object(drive: DriveUnderTest) -> None:
    open_mapping(drive, 0x1400, RPDO1)
    assert drive.write(0x1600, 1, PLACEHOLDER, 4) == 0
    assert drive.write(0x1600, 2, CONTROLWORD, 4) == 0
    assert drive.write(0x1600, 0, 2, 1) == 0
    assert drive.write(0x1400, 1, RPDO1, 4) == 0
    drive.nmt(START)
    drive.send(RPDO1, "ffff0600")
    drive.sync()
    assert drive.read(0x6040) == 6
