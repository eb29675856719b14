"""What a device may do in one way or another passes; CANopenNode's demo device does each of these."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from tests.canopen.device_under_test import SECTIONS, eds_text, var
from tests.conformance.virtual_bus import SERVO_EDS, VirtualBus, under_test

from hilbench.apps.conformance.examine import examine
from hilbench.apps.conformance.listing import listed_cases
from hilbench.apps.conformance.record import Verdict
from hilbench.can.frame import REMOTE_FLAG, Frame
from hilbench.canopen.object_store import SEQUENCE_NUMBER, UNKNOWN_COMMAND
from hilbench.errors import BenchFaultError

NODE, REQUEST, ANSWER, HEARTBEAT = 5, 0x605, 0x585, 0x705
REAL32, VISIBLE_STRING = 8, 9


def counts_from_another_sync(bus: VirtualBus) -> None:
    def receive(frame: Frame) -> Frame:
        if (frame.can_id, frame.data) == (0, bytes((1, NODE))):
            bus.device.handle(frame)
            for _ in range(2):
                bus.device.sync(b"")
        return frame

    bus.hears.append(receive)


def heartbeat_is_under_way_as_it_is_reset(bus: VirtualBus) -> None:
    """Sent before the device takes the command, and on the wire behind it."""

    def receive(frame: Frame) -> Frame:
        if (frame.can_id, frame.data[:1]) == (0, b"\x81"):
            bus.put(Frame(HEARTBEAT, b"\x7f"))
        return frame

    bus.hears.append(receive)


def emcy_comes_late(bus: VirtualBus) -> None:
    """As from a device that others keep busy: half a second behind its cause."""
    late: list[tuple[int, Frame]] = []

    def say(frame: Frame) -> Frame | None:
        if frame.can_id != 0x80 + NODE:
            return frame
        late.append((bus.clock.ns + 500_000_000, frame))
        return None

    def step() -> None:
        while late and bus.clock.ns >= late[0][0]:
            bus.put(late.pop(0)[1])

    bus.says.append(say)
    bus.steps.append(step)


def answers_the_second_of_two_syncs(bus: VirtualBus) -> None:
    """From its SYNC start value on: that is the first of two."""

    def receive(frame: Frame) -> Frame:
        if frame.can_id == 0x80 and len(frame.data) == 1:
            return Frame(0x80, bytes((frame.data[0] - 1 or 10,)))
        return frame

    bus.hears.append(receive)


def begins_with_a_heartbeat(bus: VirtualBus) -> None:
    """Soon after 1017h is written, not a period later."""

    def receive(frame: Frame) -> Frame:
        if frame.data[:4] == b"\x2b\x17\x10\x00" and any(frame.data[4:6]):
            bus.device.handle(frame)
            bus.device.producer.sent_until(bus.clock.ns + 20_000_000)
            return Frame(0x7FF, b"")
        return frame

    bus.hears.append(receive)


def tells_an_error_once(bus: VirtualBus) -> None:
    """It has had a short RPDO before the examination, and tells of the next one after a right one only."""
    told = [True]

    def receive(frame: Frame) -> Frame:
        if frame.can_id == 0x205 and len(frame.data) == 2:
            told[0] = False
        return frame

    def say(frame: Frame) -> Frame | None:
        if frame.can_id != 0x85 or frame.data[:2] != b"\x10\x82":
            return frame
        again, told[0] = told[0], True
        return None if again else frame

    bus.hears.append(receive)
    bus.says.append(say)


def ends_a_block_that_it_does_not_understand(bus: VirtualBus) -> None:
    wrong, other = (code.to_bytes(4, "little") for code in (SEQUENCE_NUMBER, UNKNOWN_COMMAND))
    bus.says.append(
        lambda frame: Frame(ANSWER, frame.data[:4] + other) if frame.data[4:] == wrong else frame,
    )


def has_no_error_that_lasts(bus: VirtualBus) -> None:
    """A short RPDO is told, and nothing is wrong afterwards."""

    def say(frame: Frame) -> Frame | None:
        if frame.can_id == 0x85:
            return None if frame.data[:2] == bytes(2) else Frame(0x85, frame.data[:2] + b"\0" + frame.data[3:])
        return Frame(ANSWER, b"\x4f\x01\x10" + bytes(5)) if frame.data[:4] == b"\x4f\x01\x10\x00" else frame

    bus.says.append(say)


CHOICES: list[tuple[Callable[[VirtualBus], None], set[str]]] = [
    (counts_from_another_sync, {"PDO 6", "SYNC 3"}),
    (answers_the_second_of_two_syncs, {"PDO 8"}),
    (begins_with_a_heartbeat, {"Heartbeat and guarding 4", "Heartbeat and guarding 5"}),
    (tells_an_error_once, {"EMCY 4", "EMCY 5", "EMCY 6"}),
    (has_no_error_that_lasts, {"EMCY 4", "EMCY 5"}),
    (heartbeat_is_under_way_as_it_is_reset, {"NMT 1"}),
    (emcy_comes_late, {"EMCY 4"}),
    (ends_a_block_that_it_does_not_understand, {"SDO 27"}),
]


@pytest.mark.parametrize(("choice", "cases"), CHOICES, ids=lambda value: getattr(value, "__name__", ""))
def test_what_a_device_is_free_to_do_passes(choice: Callable[[VirtualBus], None], cases: set[str]) -> None:
    bus = VirtualBus()
    choice(bus)
    results = list(examine(under_test(bus), sorted({case.rpartition(" ")[0] for case in cases})))
    verdicts = {result.name: result.verdict for result in results}
    assert {case: verdicts[case] for case in cases} == dict.fromkeys(cases, Verdict.PASSED)


def test_a_device_that_forbids_remote_requests_and_answers_none_lacks_them() -> None:
    bus = VirtualBus()
    assert bus.device.cell(0x1800, 1).value & 0x40000000
    bus.hears.append(lambda frame: Frame(0x7FF, b"") if frame.can_id & REMOTE_FLAG else frame)
    [case] = [result for result in examine(under_test(bus), ["PDO"]) if result.name == "PDO 3"]
    assert case.verdict is Verdict.NOT_APPLICABLE
    assert "1800h:1 forbids remote requests" in case.reason


def test_a_device_that_allows_remote_requests_and_answers_none_fails() -> None:
    bus = VirtualBus()
    bus.device.cell(0x1800, 1).value &= ~0x40000000
    bus.hears.append(lambda frame: Frame(0x7FF, b"") if frame.can_id & REMOTE_FLAG else frame)
    [case] = [result for result in examine(under_test(bus), ["PDO"]) if result.name == "PDO 3"]
    assert case.verdict is Verdict.FAILED


def test_a_file_with_real_numbers_and_letters_beyond_ascii_is_examined(tmp_path: Path) -> None:
    eds = tmp_path / "device.eds"
    more = {"2100": var("Text", VISIBLE_STRING, "rw", "a '€'"), "2101": var("Number", REAL32, "rw", "12.345")}
    eds.write_text(eds_text({**SECTIONS, **more}), encoding="utf-8")
    results = {result.name: result for result in examine(under_test(VirtualBus(SERVO_EDS), eds), ["EDS", "OD"])}
    assert results["OD 7"].steps
    assert not any("2101" in step.seen for step in results["EDS 1"].steps)
    assert any("2101" in note for note in results["EDS 1"].notes)


def test_a_device_that_does_not_come_back_from_its_reset_is_told_in_one_line() -> None:
    bus = VirtualBus()
    bus.says.append(lambda frame: None if frame.can_id == HEARTBEAT else frame)
    with pytest.raises(
        BenchFaultError, match=r"node 5 can't be examined: boot-up message: expected 705 00, seen no 705"
    ):
        list(examine(under_test(bus, store=True), ["EMCY"]))


def test_a_parameter_that_is_not_readable_for_a_while_between_two_cases_does_not_end_the_examination() -> None:
    bus = VirtualBus()
    refused: list[Frame] = []

    def say(frame: Frame) -> Frame:
        if frame.can_id == ANSWER and frame.data[:4] == b"\x43\x00\x14\x01" and len(refused) < 12:
            refused.append(frame)
            return Frame(ANSWER, b"\x80" + frame.data[1:4] + (0x08000022).to_bytes(4, "little"))
        return frame

    dut = under_test(bus)
    results = []
    for result in examine(dut, ["PDO", "OD"]):
        results.append(result)
        if result.name == "PDO 1":
            bus.says.append(say)
    assert len(refused) == 12
    assert {result.name for result in results} >= {"PDO 33", "OD 9"}


def test_a_device_without_emcy_misses_none_of_a_lost_heartbeat(tmp_path: Path) -> None:
    eds = tmp_path / "silent.eds"
    eds.write_text(eds_text({index: text for index, text in SECTIONS.items() if index not in ("1014", "1015")}))
    results = list(examine(under_test(VirtualBus(SERVO_EDS), eds), ["Heartbeat"]))
    assert [result.name for result in results if result.verdict is Verdict.NOT_APPLICABLE] == [
        "Heartbeat 6",
        "Heartbeat 7",
    ]


def test_what_a_device_without_a_mappable_object_cannot_do_is_not_applicable(tmp_path: Path) -> None:
    text = SERVO_EDS.read_text().replace("PDOMapping=1", "PDOMapping=0")
    text = re.sub(
        r"(?<=DefaultValue=\$NODEID\+)0x[0-9A-F]+(?=\nPDOMapping)", lambda id_: hex(int(id_[0], 16) | 0x80000000), text
    )
    eds = tmp_path / "nothing_mappable.eds"
    eds.write_text(text)
    results = {
        result.number: result
        for result in examine(under_test(VirtualBus(eds), eds=eds), {"PDO"})
        if result.group == "PDO"
    }
    assert len(results) > 20
    for number in (23, 24, 26):
        assert (results[number].verdict, results[number].reason[:34]) == (
            Verdict.NOT_APPLICABLE,
            "no object from 2000h on may be map",
        )


def test_a_case_that_fails_unexpectedly_is_one_case(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(_dut: object) -> None:
        raise IndexError("bytes index out of range")

    cases = [replace(case, actions=[fails]) if case.name == "SYNC 1" else case for case in listed_cases()]
    monkeypatch.setattr("hilbench.apps.conformance.examine.listed_cases", lambda: cases)
    results = {
        result.number: result for result in examine(under_test(VirtualBus()), {"SYNC"}) if result.group == "SYNC"
    }
    assert (results[1].verdict, results[1].reason) == (
        Verdict.FAILED,
        "unexpected IndexError: bytes index out of range",
    )
    assert len(results) > 1


def test_a_history_with_errors_is_no_failure() -> None:
    bus = VirtualBus()
    for code in (0x4000, 0x3000):
        bus.device.emergency(code, 1)
        bus.device.clear_emergency(code)
    results = [result for result in examine(under_test(bus), {"OD"}) if "1003h" in result.reason]
    assert results == []
