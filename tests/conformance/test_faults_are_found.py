"""Ten faults of a slave: each is found by the case that is about it, all ten in one, and none in the sound one."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.conformance.virtual_bus import VirtualBus, under_test

from hilbench.apps.conformance.examine import examine
from hilbench.apps.conformance.record import Verdict
from hilbench.can.frame import Frame
from hilbench.canopen.object_store import NO_OBJECT, NO_SUB_INDEX, PDO_LENGTH, READ_ONLY
from hilbench.cia402.state_machine import State

NODE, ANSWER, REQUEST, HEARTBEAT = 5, 0x585, 0x605, 0x705


def is_abort(frame: Frame, code: int) -> bool:
    return frame.can_id == ANSWER and frame.data[:1] == b"\x80" and frame.data[4:] == code.to_bytes(4, "little")


def wrong_abort_code(bus: VirtualBus) -> None:
    other = NO_SUB_INDEX.to_bytes(4, "little")
    bus.says.append(lambda frame: Frame(ANSWER, frame.data[:4] + other) if is_abort(frame, NO_OBJECT) else frame)


def taken_all_the_same(bus: VirtualBus, code: int) -> None:
    bus.says.append(
        lambda frame: Frame(ANSWER, b"\x60" + frame.data[1:4] + bytes(4)) if is_abort(frame, code) else frame
    )


def read_only_is_written(bus: VirtualBus) -> None:
    taken_all_the_same(bus, READ_ONLY)


def mapping_is_not_limited(bus: VirtualBus) -> None:
    taken_all_the_same(bus, PDO_LENGTH)


def transition_7_is_missing(bus: VirtualBus) -> None:
    cell = bus.device.cell(0x6040)
    obeyed = cell.on_write
    assert obeyed is not None

    def write(controlword: int) -> None:
        if not (bus.node.drive.state is State.READY_TO_SWITCH_ON and not controlword & 0x02):
            obeyed(controlword)

    cell.on_write = write


def acts_as(bus: VirtualBus, index: int, sub: int, acting: Callable[[int], int]) -> None:
    """An object that shows what was written to it, while the device goes by another value."""
    cell = bus.device.cell(index, sub)
    shown = [int(cell.value)]
    check = cell.on_write

    def write(value: int) -> None:
        if check is not None:
            check(value)
        shown[0] = value

    def act() -> None:
        cell.value = acting(shown[0])

    cell.on_write, cell.on_read = write, lambda: shown[0]
    bus.steps.append(act)


def inhibit_time_is_ignored(bus: VirtualBus) -> None:
    acts_as(bus, 0x1800, 3, lambda _: 0)


def heartbeat_period_is_off(bus: VirtualBus) -> None:
    acts_as(bus, 0x1017, 0, lambda period: period * 5 // 4)


def quick_stop_option_is_ignored(bus: VirtualBus) -> None:
    acts_as(bus, 0x605A, 0, lambda _: 2)


def wrong_boot_up(bus: VirtualBus) -> None:
    bus.says.append(lambda frame: Frame(HEARTBEAT, b"\x7f") if frame[:2] == (HEARTBEAT, b"\x00") else frame)


def toggle_bit_is_not_checked(bus: VirtualBus) -> None:
    toggle = [0x00]

    def receive(frame: Frame) -> Frame:
        if frame.can_id != REQUEST or frame.data[0] & 0xE0 != 0x60:
            toggle[0] = 0x00
            return frame
        asked = bytes((0x60 | toggle[0],)) + frame.data[1:]
        toggle[0] ^= 0x10
        return Frame(REQUEST, asked)

    bus.hears.append(receive)


def remote_bit_is_missing(bus: VirtualBus) -> None:
    cell = bus.device.cell(0x6041)
    cell.on_read = lambda: int(cell.value) & ~0x0200


FAULTS = {
    wrong_abort_code: "SDO 6",
    transition_7_is_missing: "Drive states 3",
    inhibit_time_is_ignored: "PDO 4",
    wrong_boot_up: "NMT 1",
    heartbeat_period_is_off: "Heartbeat 2",
    toggle_bit_is_not_checked: "SDO 17",
    read_only_is_written: "OD 3",
    mapping_is_not_limited: "PDO 26",
    quick_stop_option_is_ignored: "Option codes 1",
    remote_bit_is_missing: "Drive states 8",
}


def failed(bus: VirtualBus, *groups: str) -> set[str]:
    results = list(examine(under_test(bus, motion=True), groups))
    return {result.name for result in results if result.verdict is Verdict.FAILED}


@pytest.mark.slow
def test_the_sound_drive_has_none() -> None:
    assert failed(VirtualBus()) == set()


@pytest.mark.parametrize(("put_in", "case"), FAULTS.items(), ids=[fault.__name__ for fault in FAULTS])
def test_a_fault_is_found_by_the_case_that_is_about_it(put_in: Callable[[VirtualBus], None], case: str) -> None:
    bus = VirtualBus()
    put_in(bus)
    assert case in failed(bus, case.rpartition(" ")[0])


def test_ten_faults_in_one_slave_are_ten() -> None:
    bus = VirtualBus()
    for put_in in FAULTS:
        put_in(bus)
    assert set(FAULTS.values()) <= failed(bus)


def test_a_failed_case_shows_what_was_sent_expected_and_seen() -> None:
    bus = VirtualBus()
    wrong_abort_code(bus)
    found = {result.name: result for result in examine(under_test(bus), ["SDO"])}
    [step] = found["SDO 6"].steps
    assert step.sent == "605 40 04 10 00 00 00 00 00"
    assert step.expected == "585 80 04 10 00 00 00 02 06"
    assert step.seen == "585 80 04 10 00 11 00 09 06"
    assert found["SDO 6"].clause == "CiA 301, 7.2.4.3.6 and table 22"
