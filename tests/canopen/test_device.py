"""NMT, SYNC, heartbeat, EMCY and storage of a device (CiA 301) beyond the conformance cases."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.canopen.device_under_test import SECTIONS, U8, U16, DeviceUnderTest, var

from hilbench.canopen.identifiers import NmtState
from hilbench.errors import UnusableInputError

SAVE = int.from_bytes(b"save", "little")


def test_boot_up_and_pre_operational(tmp_path: Path) -> None:
    dut = DeviceUnderTest(tmp_path)
    dut.device.boot()
    assert dut.frames() == [(0x705, "00")]
    assert dut.device.nmt_state is NmtState.PRE_OPERATIONAL


@pytest.mark.parametrize(
    ("place", "named"),
    [({"1017": var("Heartbeat", 9)}, "1017h sub 0"), ({"1400sub1": var("COB-ID", 0xF)}, "1400h sub 1 'COB-ID'")],
)
def test_a_file_whose_objects_of_cia_301_are_no_numbers_is_refused_in_one_line(
    tmp_path: Path, place: dict[str, str], named: str
) -> None:
    with pytest.raises(UnusableInputError, match=f"{named}.* is of data type .*, expected an integer"):
        DeviceUnderTest(tmp_path, sections=SECTIONS | place)


@pytest.mark.parametrize(("command", "state"), [(1, 5), (2, 4), (128, 127)])
def test_nmt_commands_to_all_nodes(dut: DeviceUnderTest, command: int, state: int) -> None:
    dut.nmt(command, node=0)
    assert dut.device.nmt_state == state


def test_reset_node_boots_anew_with_power_on_values(dut: DeviceUnderTest) -> None:
    states: list[NmtState] = []
    dut.device.on_nmt = states.append
    dut.write(0x2000, 0, 50, 2)
    dut.write(0x1017, 0, 100, 2)
    assert dut.nmt(129) == [(0x705, "00")]
    assert states == [NmtState.INITIALISING, NmtState.PRE_OPERATIONAL]
    assert (dut.device.cell(0x2000).value, dut.device.cell(0x1017).value) == (-7, 0)


# -- SYNC ------------------------------------------------------------------------------------------------


def test_sync_length_follows_1019(dut: DeviceUnderTest) -> None:
    dut.after(0)
    assert dut.sync(b"\x01") == [(0x085, "4082110100000000")]
    assert dut.sync() == [(0x085, "0000004082000000"), (0x185, "000000000000")]
    assert dut.write(0x1019, 0, 240, 1) == 0
    assert dut.sync() == [(0x085, "4082110000000000")]


@pytest.mark.parametrize(("state", "said"), [(128, [(0x085, "4082110100000000")]), (2, [])])
def test_sync_of_another_length_outside_operational(
    dut: DeviceUnderTest, state: int, said: list[tuple[int, str]]
) -> None:
    dut.nmt(state)
    assert dut.sync(b"\x01") == said


def test_sync_identifier(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1005, 0, 0x40000080, 4) == 0x06090030
    assert dut.write(0x1005, 0, 0x20000080, 4) == 0x06090030
    assert dut.write(0x1005, 0, 0x090, 4) == 0
    assert dut.device.sync_cob_id == 0x090


def test_window_length_is_kept(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1007, 0, 1500, 4) == 0
    assert dut.read(0x1007) == 1500


# -- heartbeat -------------------------------------------------------------------------------------------


def test_heartbeat_period_does_not_drift_with_late_polls(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1017, 0, 100, 2)
    sent = sum(len(dut.after(7)) for _ in range(1000))
    assert sent == 70


def test_consumer_watches_from_the_first_heartbeat_on(dut: DeviceUnderTest) -> None:
    told: list[int] = []
    dut.device.on_communication_error = told.append
    dut.after(0)
    assert dut.write(0x1016, 1, 127 << 16 | 200, 4) == 0
    assert dut.after(1000) == []
    dut.send(0x77F, "05")
    assert dut.after(200) == []
    assert dut.after(1) == [(0x085, "3081117f00000000")]
    assert told == [0x8130]
    assert dut.device.nmt_state is NmtState.PRE_OPERATIONAL
    assert dut.send(0x77F, "05") == [(0x085, "0000003081000000")]


def test_boot_up_is_no_heartbeat(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1029, 1, 1, 1)
    dut.write(0x1016, 1, 127 << 16 | 200, 4)
    dut.send(0x77F, "00")
    assert dut.after(1000) == []  # the node may have none to send
    dut.send(0x77F, "05")
    assert dut.after(150) == []
    dut.send(0x77F, "00")
    assert dut.after(51) == [(0x085, "3081117f00000000")]


@pytest.mark.parametrize(("behaviour", "state"), [(0, 127), (1, 5), (2, 4)])
def test_error_behaviour_1029(dut: DeviceUnderTest, behaviour: int, state: int) -> None:
    dut.write(0x1029, 1, behaviour, 1)
    dut.write(0x1016, 1, 127 << 16 | 200, 4)
    dut.send(0x77F, "05")
    dut.after(201)
    assert dut.device.nmt_state == state


def test_error_behaviour_leaves_pre_operational_alone(dut: DeviceUnderTest) -> None:
    dut.nmt(128)
    states: list[NmtState] = []
    dut.device.on_nmt = states.append
    dut.write(0x1016, 1, 127 << 16 | 200, 4)
    dut.send(0x77F, "05")
    dut.after(201)
    assert states == []


def test_two_lost_nodes_are_two_errors(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1029, 1, 1, 1)
    dut.write(0x1016, 1, 126 << 16 | 200, 4)
    dut.write(0x1016, 2, 127 << 16 | 200, 4)
    dut.send(0x77E, "05")
    dut.send(0x77F, "05")
    assert [data[6:8] for _, data in dut.after(201)] == ["7e", "7f"]
    assert dut.send(0x77E, "05") == [(0x085, "0000113081000000")]
    assert dut.send(0x77F, "05") == [(0x085, "0000003081000000")]


# -- EMCY ------------------------------------------------------------------------------------------------


def test_emergency_register_and_history(dut: DeviceUnderTest) -> None:
    dut.device.emergency(0x2310, 0x02, b"\x01\x02\x03")
    dut.device.emergency(0x4210, 0x08)
    dut.device.emergency(0x4210, 0x08)
    assert dut.frames() == [(0x085, "1023030102030000"), (0x085, "10420b0000000000")]
    assert dut.read(0x1001) == 0x0B
    assert [dut.read(0x1003, sub) for sub in (0, 1, 2)] == [2, 0x4210, 0x02012310]
    dut.device.clear_emergency(0x2310)
    assert dut.frames() == [(0x085, "0000091023000000")]
    dut.device.clear_emergency(0x4210)
    assert dut.frames() == [(0x085, "0000001042000000")]
    assert dut.read(0x1001) == 0


def test_history_keeps_the_newest_and_takes_zero_only(dut: DeviceUnderTest) -> None:
    for code in (0x1000, 0x2000, 0x3000, 0x4000):
        dut.device.emergency(code, 1)
    dut.frames()
    assert [dut.read(0x1003, sub) for sub in range(4)] == [3, 0x4000, 0x3000, 0x2000]
    assert dut.write(0x1003, 0, 1, 1) == 0x06090030
    assert dut.write(0x1003, 0, 0, 1) == 0
    assert dut.read(0x1003, 0) == 0


def test_error_in_stopped_counts_but_is_not_sent(dut: DeviceUnderTest) -> None:
    dut.nmt(2)
    dut.device.emergency(0x2310, 0x02)
    assert dut.frames() == []
    dut.nmt(128)
    assert dut.read(0x1001) == 0x03
    assert dut.read(0x1003, 1) == 0x2310


def test_emcy_inhibit_time(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1015, 0, 100, 2)  # 10 ms
    dut.device.emergency(0x2310, 2)
    dut.device.emergency(0x4210, 8)
    assert [data[:4] for _, data in dut.frames()] == ["1023"]
    assert dut.after(9) == []
    assert [data[:4] for _, data in dut.after(1)] == ["1042"]


def test_emcy_identifier(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1014, 0, 0x95, 4) == 0x06090030
    assert dut.write(0x1014, 0, 0x80000085, 4) == 0
    dut.device.emergency(0x2310, 2)
    assert dut.frames() == []
    assert dut.write(0x1014, 0, 0x701, 4) == 0x06090030
    assert dut.write(0x1014, 0, 0x95, 4) == 0
    dut.device.clear_emergency(0x2310)
    assert dut.frames()[0][0] == 0x95


# -- store and restore -----------------------------------------------------------------------------------


def test_stored_values_survive_the_process(tmp_path: Path) -> None:
    file = tmp_path / "device.json"
    dut = DeviceUnderTest(tmp_path, store=file).started()
    dut.write(0x2000, 0, 50, 2)
    dut.write(0x1017, 0, 100, 2)
    assert dut.write(0x1010, 1, SAVE, 4) == 0
    again = DeviceUnderTest(tmp_path, store=file).started()
    assert (again.device.cell(0x2000).value, again.device.cell(0x1017).value) == (50, 100)
    assert sorted(path.name for path in tmp_path.glob("device.*")) == ["device.eds", "device.json"]


def test_set_points_are_not_stored(dut: DeviceUnderTest) -> None:
    dut.write(0x6040, 0, 0x0F, 2)
    dut.write(0x1010, 1, SAVE, 4)
    dut.nmt(129)
    assert dut.device.cell(0x6040).value == 0


@pytest.mark.parametrize("text", ["{", '{"2000:00": "0102030405"}', '{"2000": 7}', "[]"])
def test_damaged_store_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "device.json"
    file.write_text(text)
    with pytest.raises(UnusableInputError, match=r"device\.json"):
        DeviceUnderTest(tmp_path, store=file)


def test_missing_object_is_named(tmp_path: Path) -> None:
    sections = {name: text for name, text in SECTIONS.items() if name != "1001"}
    with pytest.raises(UnusableInputError, match="1001h is missing"):
        DeviceUnderTest(tmp_path, sections=sections)


REMOTE = 0x40000000
GUARDED = {"100C": var("Guard time", U16), "100D": var("Life time factor", U8)}


def test_a_master_that_guards_gets_the_state_with_a_bit_that_toggles(tmp_path: Path) -> None:
    dut = DeviceUnderTest(tmp_path, sections=SECTIONS | GUARDED).booted()
    guarded = [dut.send(0x705 | REMOTE) for _ in range(3)]
    assert guarded == [[(0x705, "7f")], [(0x705, "ff")], [(0x705, "7f")]]
    dut.nmt(1)
    assert dut.send(0x705 | REMOTE) == [(0x705, "85")]
    dut.nmt(129)
    assert dut.send(0x705 | REMOTE) == [(0x705, "7f")]
    assert dut.write(0x1017, 0, 100, 2) == 0
    assert dut.send(0x705 | REMOTE) == [], "heartbeat takes the place of guarding"


def test_a_master_that_stops_guarding_is_missed_and_welcome_back(tmp_path: Path) -> None:
    dut = DeviceUnderTest(tmp_path, sections=SECTIONS | GUARDED).started()
    told: list[int] = []
    dut.device.on_communication_error = told.append
    assert (dut.write(0x100C, 0, 100, 2), dut.write(0x100D, 0, 3, 1)) == (0, 0)
    assert not [frame for frame in dut.after(1000) if frame[0] == 0x085], "it begins with the first remote frame"
    for _ in range(5):
        dut.send(0x705 | REMOTE)
        assert not [frame for frame in dut.after(290) if frame[0] == 0x085]
    assert [frame for frame in dut.after(20) if frame[0] == 0x085] == [(0x085, "3081110000000000")]
    assert (told, dut.device.nmt_state) == ([0x8130], 127)
    assert (0x085, "0000003081000000") in dut.send(0x705 | REMOTE)


def test_a_device_without_100ch_is_not_guarded(tmp_path: Path) -> None:
    dut = DeviceUnderTest(tmp_path).booted()
    assert dut.send(0x705 | REMOTE) == []
