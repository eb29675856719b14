"""Our own drive: what passes, what does not apply, and that nothing is another after an examination."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.canopen.device_under_test import SECTIONS as PLAIN
from tests.canopen.device_under_test import U8, U16, eds_text, var
from tests.cia402.every_mode import eds_file
from tests.conformance.virtual_bus import SERVO_EDS, VirtualBus, under_test
from tests.tiers import slow

from hilbench.apps.conformance.examine import examine
from hilbench.apps.conformance.listing import listed_cases
from hilbench.apps.conformance.record import CaseResult, Verdict
from hilbench.errors import UnusableInputError
from hilbench.plant.motor_port import MotorMode

SIZES = {
    "EDS": 1,
    "SDO": 30,
    "PDO": 33,
    "OD": 9,
    "EMCY": 6,
    "SYNC": 10,
    "Guarding": 6,
    "Heartbeat": 7,
    "Heartbeat and guarding": 7,
    "Store and restore": 10,
    "NMT": 8,
    "Drive states": 9,
    "Option codes": 7,
    "Modes": 6,
    "Limits": 3,
}
#: Of the 127 cases of CiA 301, what the servo drive lacks.
NOT_APPLICABLE = {
    *(f"SDO {number}" for number in (4, 14, 20, 24, 29, 30)),
    "OD 4",
    *(f"SYNC {number}" for number in (2, 7)),
    *(f"Guarding {number}" for number in range(1, 7)),
    *(f"Heartbeat and guarding {number}" for number in (3, 6, 7)),
    "Store and restore 9",
}
OF_DRIVES = {"Drive states", "Option codes", "Modes", "Limits"}


def names(results: list[CaseResult], verdict: Verdict) -> set[str]:
    return {result.name for result in results if result.verdict is verdict}


def test_the_list_is_whole_and_each_case_is_examined() -> None:
    numbers = {group: [case.number for case in listed_cases() if case.group == group] for group in SIZES}
    assert numbers == {group: list(range(1, size + 1)) for group, size in SIZES.items()}
    assert sum(size for group, size in SIZES.items() if group not in OF_DRIVES) == 127


def test_servo_drive_passes_all_that_its_file_has() -> None:
    results = list(examine(under_test(VirtualBus(), motion=True, store=True)))
    assert names(results, Verdict.FAILED) == names(results, Verdict.NOT_ALLOWED) == set()
    absent = names(results, Verdict.NOT_APPLICABLE)
    assert {name for name in absent if name.rpartition(" ")[0] not in OF_DRIVES} == NOT_APPLICABLE
    assert {name for name in absent if name.rpartition(" ")[0] in OF_DRIVES} == {
        *("Modes 3", "Limits 1", "Limits 3"),  # 6502h of the file lacks profile position mode
        "Drive states 9",  # one axis
    }
    assert all(result.reason for result in results if result.verdict is not Verdict.PASSED)
    assert all(result.steps for result in results if result.verdict is Verdict.PASSED)


def test_drive_with_every_mode_passes_what_its_file_has(tmp_path: Path) -> None:
    eds = eds_file(tmp_path)
    results = list(examine(under_test(VirtualBus(eds), eds, motion=True), list(OF_DRIVES)))
    assert names(results, Verdict.FAILED) == set()
    assert {"Modes 3", "Modes 4", "Modes 5", "Modes 6", "Limits 1", "Limits 3"} <= names(results, Verdict.PASSED)


def test_write_only_objects_are_examined_where_there_are_some(tmp_path: Path) -> None:
    eds = tmp_path / "device.eds"
    eds.write_text(eds_text({**PLAIN, "2001": var("Write only", U8, "wo", ""), "6060": var("Mode", U16)}))
    results = list(examine(under_test(VirtualBus(eds), eds), ["SDO", "OD"]))
    assert {"SDO 4", "OD 4"} <= names(results, Verdict.PASSED)


def test_nothing_moves_and_nothing_is_stored_without_being_allowed() -> None:
    bus = VirtualBus()
    signatures: list[object] = []
    for index in (0x1010, 0x1011):
        for sub in (1, 2):
            bus.device.cell(index, sub).on_write = signatures.append
    modes = set()
    bus.steps.append(lambda: modes.add(bus.node.port.mode))
    results = list(examine(under_test(bus)))
    assert modes == {MotorMode.OFF}
    assert signatures == []
    assert names(results, Verdict.FAILED) == set()
    refused = names(results, Verdict.NOT_ALLOWED)
    assert {"Drive states 5", "Option codes 1", "Modes 4", "Store and restore 2", "SYNC 8"} <= refused
    assert {"SDO 5", "PDO 4", "Drive states 2", "Drive states 3", "Modes 1"} <= names(results, Verdict.PASSED)


@pytest.mark.parametrize("allowed", [True, *slow(False)])
def test_everything_is_as_it_was_afterwards(allowed: bool) -> None:
    bus = VirtualBus()
    device = bus.device
    device.cell(0x1800, 3).value = 70
    device.cell(0x1017).value = 250
    device.cell(0x1400, 1).value = 0x80000305
    before = values(bus)
    results = list(examine(under_test(bus, motion=allowed, store=allowed)))
    assert names(results, Verdict.FAILED) == set()
    assert values(bus) == before
    device.reset_node()
    after_reset = VirtualBus()
    assert values(bus) == values(after_reset)  # what was stored at power-on is stored: the defaults


def values(bus: VirtualBus) -> dict[tuple[int, int], object]:
    od = bus.device._store.od
    keys = [(index, 0) for index in (0x1005, 0x1006, 0x1014, 0x1015, 0x1017, 0x1019, 0x605A, 0x6007, 0x6060, 0x6084)]
    keys += [
        (index, sub)
        for base in (0x1400, 0x1600, 0x1800, 0x1A00)
        for index in range(base, base + 4)
        for sub in (od[index].subindices)
    ]
    return {key: bus.device.cell(*key).value for key in keys}


def test_a_drive_with_power_is_left_alone() -> None:
    bus = VirtualBus()
    for word in (0x06, 0x07, 0x0F):
        bus.send(0x605, bytes((0x2B, 0x40, 0x60, 0, word, 0, 0, 0)))
    with pytest.raises(UnusableInputError, match="OPERATION ENABLED, expected a drive without power"):
        list(examine(under_test(bus)))
    assert SERVO_EDS.exists()


def test_a_drive_with_guarding_passes_its_cases(tmp_path: Path) -> None:
    eds = tmp_path / "guarded.eds"
    added = {"100C": var("Guard time", U16), "100D": var("Life time factor", U8)}
    eds.write_text(SERVO_EDS.read_text() + "\n" + eds_text(added))
    found = list(examine(under_test(VirtualBus(eds), eds), ["Guarding", "Heartbeat and guarding"]))
    assert names(found, Verdict.FAILED) == set()
    assert names(found, Verdict.NOT_APPLICABLE) == {"Guarding 4", "Heartbeat and guarding 5"}
