"""A node with two axes is examined by its EDS file: cases of CiA 301 once, those of CiA 402 for each axis."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.conformance.virtual_bus import VirtualBus, under_test

from hilbench.apps.conformance.examine import examine
from hilbench.apps.conformance.listing import listed_cases
from hilbench.apps.conformance.record import CaseResult, Verdict
from hilbench.canopen.object_store import SdoAbort
from hilbench.errors import UnusableInputError

DUAL = Path(__file__).parents[2] / "eds" / "hilbench_servo_dual.eds"


def failed(results: list[CaseResult]) -> list[str]:
    return [result.name for result in results if result.verdict is Verdict.FAILED]


def test_every_case_passes_those_of_drives_twice() -> None:
    bus = VirtualBus(DUAL)
    results = list(examine(under_test(bus, DUAL, motion=True, store=True)))
    assert failed(results) == []
    names = [result.name for result in results]
    of_drives = sum(case.of_drives for case in listed_cases())
    assert len(names) == len(set(names)) == len(listed_cases()) + of_drives + 1
    for axis in (1, 2):
        assert {result.verdict for result in results if result.name == f"Drive states 9, axis {axis}"} == {
            Verdict.PASSED
        }
    of_second = [step.sent for result in results if result.axis == 2 for step in result.steps]
    assert any("2b 40 68 00" in sent for sent in of_second)  # 6840h is written
    assert not any("2b 40 60 00" in sent for sent in of_second)


def test_a_fault_of_the_second_axis_is_found_by_its_own_case_alone() -> None:
    def refuse(_code: object) -> None:
        raise SdoAbort(0x06010002)

    bus = VirtualBus(DUAL)
    bus.device.cell(0x6860).on_write = refuse
    results = list(examine(under_test(bus, DUAL), ["Modes"]))
    assert failed(results) == ["Modes 1, axis 2"]


@pytest.mark.parametrize(("index", "wrong"), [(0x1000, 0x0002_0192), (0x6FFF, 0x0002_0191)])
def test_a_wrong_device_type_is_found(index: int, wrong: int) -> None:
    bus = VirtualBus(DUAL)
    bus.device.cell(index).on_read = lambda: wrong
    assert "Drive states 9, axis 2" in failed(list(examine(under_test(bus, DUAL), ["Drive states"])))


def test_a_second_axis_with_power_is_left_alone() -> None:
    bus = VirtualBus(DUAL)
    bus.device.cell(0x6860).write(3)
    for word in (0x06, 0x07, 0x0F):
        bus.device.cell(0x6840).write(word)
    with pytest.raises(UnusableInputError, match="OPERATION ENABLED, expected a drive without power"):
        list(examine(under_test(bus, DUAL), ["Modes"]))
