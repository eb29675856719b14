"""PDOs of a device beyond the conformance cases, as SDO configures them at run time (CiA 301, 7.2.2 and 7.5.2)."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.canopen.device_under_test import SECTIONS, U32, DeviceUnderTest, mapping, var

from hilbench.canopen.object_store import SdoAbort

INVALID = 0x80000000
TPDO1 = INVALID | 0x40000185
UNSUPPORTED, NOT_MAPPABLE, TOO_LONG, INVALID_VALUE = 0x06010000, 0x06040041, 0x06040042, 0x06090030


def set_state(dut: DeviceUnderTest, statusword: int, position: int) -> None:
    dut.device.cell(0x6041).value = statusword
    dut.device.cell(0x6064).value = position


def test_synchronous_tpdo_is_sampled_at_sync(dut: DeviceUnderTest) -> None:
    dut.sync()
    set_state(dut, 0x1237, -2)
    assert (0x185, "3712feffffff") in dut.sync()


def test_synchronous_rpdo_acts_at_the_next_sync(dut: DeviceUnderTest) -> None:
    dut.send(0x205, "0f00 10270000".replace(" ", ""))
    assert dut.device.cell(0x60FF).value == 0
    dut.sync()
    assert (dut.device.cell(0x6040).value, dut.device.cell(0x60FF).value) == (0x0F, 10000)


def test_set_points_act_before_the_tpdo_of_the_same_sync(dut: DeviceUnderTest) -> None:
    def mirror(value: object) -> None:
        dut.device.cell(0x6041).value = value

    dut.device.cell(0x6040).on_write = mirror
    dut.send(0x205, "0f0000000000")
    assert dut.sync()[0] == (0x185, "0f0000000000")


def test_event_driven_rpdo_acts_at_once(dut: DeviceUnderTest) -> None:
    dut.send(0x305, "9cff")
    assert dut.device.cell(0x6071).value == -100


@pytest.mark.parametrize("command", [2, 128])
def test_no_pdo_outside_operational(dut: DeviceUnderTest, command: int) -> None:
    dut.nmt(command)
    dut.send(0x305, "9cff")
    assert dut.device.cell(0x6071).value == 0
    assert dut.sync() == []
    dut.device.cell(0x6077).value = 3
    assert dut.after(10) == []


def test_data_received_before_a_state_change_do_not_act_after_it(dut: DeviceUnderTest) -> None:
    dut.send(0x205, "0f0010270000")
    dut.nmt(128)
    dut.nmt(1)
    dut.sync()
    assert dut.device.cell(0x60FF).value == 0


def test_refused_value_of_an_rpdo_is_not_taken_and_the_others_are(dut: DeviceUnderTest) -> None:
    def refuse(value: object) -> None:
        raise SdoAbort(INVALID_VALUE)

    dut.device.cell(0x6040).on_write = refuse
    dut.send(0x205, "0f0010270000")
    dut.sync()
    assert (dut.device.cell(0x6040).value, dut.device.cell(0x60FF).value) == (0, 10000)


@pytest.mark.parametrize(("every", "sent"), [(1, [1, 2, 3, 4, 5, 6]), (2, [2, 4, 6]), (3, [3, 6]), (240, [])])
def test_cyclic_types_send_every_nth_sync(dut: DeviceUnderTest, every: int, sent: list[int]) -> None:
    assert dut.write(0x1800, 2, every, 1) == 0
    dut.nmt(128)
    dut.nmt(1)
    assert [n for n in range(1, 7) if any(can_id == 0x185 for can_id, _ in dut.sync())] == sent


def remap_tpdo1(dut: DeviceUnderTest, kind: int, start: int = 0) -> None:
    """Invalid, another type and start value, valid again, in OPERATIONAL."""
    assert dut.write(0x1800, 1, TPDO1, 4) == 0
    assert dut.write(0x1800, 2, kind, 1) == 0
    assert dut.write(0x1800, 6, start, 1) == 0
    assert dut.write(0x1800, 1, TPDO1 & ~INVALID, 4) == 0


def test_tpdo_that_becomes_valid_counts_anew_from_its_start_value(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1019, 0, 10, 1) == 0
    assert [(0x185, "000000000000") in dut.sync(bytes([n])) for n in (1, 2)] == [True, True]
    remap_tpdo1(dut, kind=2, start=5)
    assert [n for n in range(3, 10) if (0x185, "000000000000") in dut.sync(bytes([n]))] == [5, 7, 9]


def test_event_driven_tpdo_that_becomes_valid_is_sent_once(dut: DeviceUnderTest) -> None:
    dut.sync()
    dut.after(0)
    remap_tpdo1(dut, kind=254)
    assert dut.after(1) == [(0x185, "000000000000")]
    assert dut.after(100) == []


def test_a_write_to_one_tpdo_leaves_the_others_alone(dut: DeviceUnderTest) -> None:
    assert dut.after(0) == [(0x285, "0000")]
    remap_tpdo1(dut, kind=1)
    assert dut.after(100) == []


def test_event_timer_and_inhibit_time(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1801, 1, INVALID | 0x40000285, 4) == 0
    assert dut.write(0x1801, 3, 50, 2) == 0  # 5 ms
    assert dut.write(0x1801, 5, 20, 2) == 0  # 20 ms
    assert dut.write(0x1801, 1, 0x40000285, 4) == 0
    assert dut.after(0) == [(0x285, "0000")]
    dut.device.cell(0x6077).value = 1
    assert dut.after(4) == []
    assert dut.after(1) == [(0x285, "0100")]
    assert dut.after(19) == []
    assert dut.after(1) == [(0x285, "0100")]


@pytest.mark.parametrize("kind", [0, 1, 240, 254, 255])
def test_supported_transmission_types(dut: DeviceUnderTest, kind: int) -> None:
    assert dut.write(0x1800, 2, kind, 1) == 0
    assert dut.write(0x1400, 2, kind, 1) == 0


@pytest.mark.parametrize("kind", [241, 251, 252, 253])
def test_other_transmission_types_are_refused(dut: DeviceUnderTest, kind: int) -> None:
    assert dut.write(0x1800, 2, kind, 1) == INVALID_VALUE
    assert dut.write(0x1400, 2, kind, 1) == INVALID_VALUE


def test_cob_id_changes_only_while_invalid(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1800, 1, 0x40000190, 4) == INVALID_VALUE
    assert dut.write(0x1800, 1, INVALID | 0x40000190, 4) == 0
    assert dut.sync() == []
    assert dut.write(0x1800, 1, 0x40000190, 4) == 0
    assert dut.sync()[0][0] == 0x190


@pytest.mark.parametrize("cob_id", [0x20000385, 0x885])
def test_extended_identifiers_are_refused(dut: DeviceUnderTest, cob_id: int) -> None:
    dut.write(0x1800, 1, TPDO1, 4)
    assert dut.write(0x1800, 1, cob_id, 4) == INVALID_VALUE


def test_inhibit_time_and_start_value_stay_while_valid(dut: DeviceUnderTest) -> None:
    assert dut.write(0x1801, 3, 10, 2) == UNSUPPORTED
    assert dut.write(0x1800, 6, 1, 1) == UNSUPPORTED


def map_rpdo1(dut: DeviceUnderTest, *entries: int) -> int:
    """The whole procedure; the first abort code, or 0."""
    steps = [(0x1400, 1, INVALID | 0x205, 4), (0x1600, 0, 0, 1)]
    steps += [(0x1600, sub, entry, 4) for sub, entry in enumerate(entries, 1)]
    steps += [(0x1600, 0, len(entries), 1), (0x1400, 1, 0x205, 4)]
    for step in steps:
        code = dut.write(*step)
        if code:
            return code
    return 0


def test_odd_widths_and_reals_go_through_pdos(dut: DeviceUnderTest) -> None:
    assert map_rpdo1(dut, 0x20040018, 0x20060020) == 0
    dut.send(0x205, "feffff0000c0bf")
    dut.sync()
    assert (dut.device.cell(0x2004).value, dut.device.cell(0x2006).value) == (-2, -1.5)


def test_data_received_before_a_remapping_do_not_act_after_it(dut: DeviceUnderTest) -> None:
    dut.send(0x205, "0f0010270000")
    assert map_rpdo1(dut, 0x60710010) == 0
    dut.sync()
    assert [dut.device.cell(index).value for index in (0x6040, 0x60FF, 0x6071)] == [0, 0, 0]


def test_data_received_before_the_pdo_became_invalid_do_not_act(dut: DeviceUnderTest) -> None:
    dut.send(0x205, "0f0010270000")
    assert dut.write(0x1400, 1, INVALID | 0x205, 4) == 0
    assert dut.write(0x1600, 0, 0, 1) == 0
    dut.sync()
    assert dut.device.cell(0x60FF).value == 0


def test_an_invalid_rpdo_misses_nothing_and_takes_its_errors_back(dut: DeviceUnderTest) -> None:
    dut.after(0)
    assert dut.write(0x1401, 5, 20, 2) == 0
    dut.send(0x305, "0000")
    assert dut.after(21) == [(0x085, "5082110200000000")]
    frames = dut.send(0x605, f"23011401{(INVALID | 0x305).to_bytes(4, 'little').hex()}")
    assert frames == [(0x585, "6001140100000000"), (0x085, "0000005082000000")]
    assert dut.write(0x1401, 1, 0x305, 4) == 0
    dut.send(0x305, "0000")
    assert dut.write(0x1401, 1, INVALID | 0x305, 4) == 0
    assert dut.after(100) == []


@pytest.mark.parametrize(
    ("entries", "abort"),
    [
        pytest.param([0x12340010], 0x06020000, id="no object"),
        pytest.param([0x10180920], 0x06090011, id="no sub-index"),
        pytest.param([0x60400020], NOT_MAPPABLE, id="length is not the object's"),
        pytest.param([0x20050008], NOT_MAPPABLE, id="a BOOLEAN is one bit"),
        pytest.param([0x00040020], NOT_MAPPABLE, id="placeholder that DummyUsage forbids"),
    ],
)
def test_mapping_refusals(dut: DeviceUnderTest, entries: list[int], abort: int) -> None:
    assert map_rpdo1(dut, *entries) == abort


def test_write_only_and_placeholders_do_not_go_into_a_tpdo(dut: DeviceUnderTest) -> None:
    dut.write(0x1800, 1, TPDO1, 4)
    dut.write(0x1A00, 0, 0, 1)
    assert dut.write(0x1A00, 1, 0x00050008, 4) == NOT_MAPPABLE
    assert dut.write(0x1A00, 1, 0x10010008, 4) == 0


def test_too_short_rpdo_is_dropped_and_reported_once(dut: DeviceUnderTest) -> None:
    assert dut.send(0x205, "0f00") == [(0x085, "1082110100000000")]
    assert dut.send(0x205, "0f00") == []
    dut.sync()
    assert dut.device.cell(0x6040).value == 0
    assert dut.send(0x205, "0f0000000000") == [(0x085, "0000001082000000")]


def test_too_long_rpdo_counts_by_its_beginning(dut: DeviceUnderTest) -> None:
    assert dut.send(0x305, "070099") == [(0x085, "2082110200000000")]
    assert dut.device.cell(0x6071).value == 7


def test_rpdo_event_timer_reports_once_and_recovers(dut: DeviceUnderTest) -> None:
    told: list[int] = []
    dut.device.on_communication_error = told.append
    dut.after(0)
    assert dut.write(0x1401, 5, 20, 2) == 0
    assert dut.after(100) == []  # the time starts with the first frame
    dut.send(0x305, "0000")
    assert dut.after(20) == []
    assert dut.after(1) == [(0x085, "5082110200000000")]
    assert dut.after(50) == []
    assert told == [0x8250]
    assert dut.device.nmt_state == 5
    assert dut.send(0x305, "0000") == [(0x085, "0000005082000000")]


def test_an_event_timer_that_is_switched_off_misses_nothing_and_leaves_no_error(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1401, 5, 20, 2)
    dut.send(0x305, "0000")
    dut.write(0x1401, 5, 0, 2)
    assert dut.after(30) == []
    dut.write(0x1401, 5, 20, 2)
    dut.send(0x305, "0000")
    dut.after(30)
    dut.write(0x1401, 5, 0, 2)
    dut.send(0x305, "0000")
    assert dut.read(0x1001) == 0


def test_a_valid_pdo_whose_default_mapping_the_eds_forbids_is_left_out_and_named(tmp_path: Path) -> None:
    dut = DeviceUnderTest(tmp_path, sections=SECTIONS | mapping(0x1600, "0x20000010"))
    (said,) = dut.device.left_out.values()
    assert said.startswith("RPDO1 is not sent or received with its default mapping: ")
    dut.nmt(1)
    dut.send(0x205, "0600")
    dut.sync()
    assert (dut.device.cell(0x1001).value, dut.device.cell(0x6040).value) == (0, 0)
    map_rpdo1(dut, 0x60400010)
    dut.send(0x205, "0600")
    dut.sync()
    assert dut.device.cell(0x6040).value == 6


@pytest.mark.parametrize("access", ["ro", "const"])
def test_a_pdo_with_a_read_only_cob_id_is_mapped_all_the_same(tmp_path: Path, access: str) -> None:
    fixed = {"1400sub1": var("COB-ID", U32, access, "$NODEID+0x200")}
    dut = DeviceUnderTest(tmp_path, sections=SECTIONS | fixed)
    dut.nmt(1)
    writes = ((0, 0, 1), (1, 0x60400010, 4), (0, 1, 1))
    assert [dut.write(0x1600, sub, value, size) for sub, value, size in writes] == [0, 0, 0]
    dut.send(0x205, "0600")
    dut.sync()
    assert dut.device.cell(0x6040).value == 6


def test_a_time_of_day_is_mapped_and_starts_with_its_default(tmp_path: Path) -> None:
    """TIME_OF_DAY (000Ch) is six bytes: milliseconds after midnight, and days."""
    time_of_day = {"2010": var("Time", 0xC, "rw", "0xA00000005", mappable=True)}
    dut = DeviceUnderTest(tmp_path, sections=SECTIONS | time_of_day | mapping(0x1A00, "0x20100030"))
    dut.nmt(1)
    assert (0x185, "050000000a00") in dut.sync()


def test_an_rpdo_that_was_too_long_and_then_too_short_leaves_no_error_when_it_is_right(dut: DeviceUnderTest) -> None:
    dut.nmt(1)
    map_rpdo1(dut, 0x60400010)
    for data in (bytes(3), bytes(1), bytes(2)):
        dut.send(0x205, data)
    assert dut.read(0x1001) == 0
