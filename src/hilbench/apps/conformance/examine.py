"""The whole examination: every case, and the device as it was before.

After each case the parameters that it wrote, and after a reset all that differ, are written back; at the end all of
them are compared. Where storing is allowed, what the device had at power-on is stored again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.listing import Case, listed_cases
from hilbench.apps.conformance.process_data import shown_state
from hilbench.apps.conformance.record import (
    CaseEndedError,
    CaseResult,
    NotAllowedError,
    NotApplicableError,
    Step,
    Verdict,
)
from hilbench.apps.conformance.restore import Lost, Values, restore, snapshot
from hilbench.canopen.identifiers import NmtCommand
from hilbench.cia402.state_machine import POWERED
from hilbench.errors import BenchFaultError, UnusableInputError

CASES: Final[Mapping[str, Callable[[DeviceUnderTest], object]]] = {case.name: case.examine for case in listed_cases()}
OF_DRIVES: Final = [case.name for case in listed_cases() if case.of_drives]
AFTERWARDS: Final = Case("Afterwards", 1, "Every parameter is what it was before", "no case of a standard")


def examine(
    dut: DeviceUnderTest,
    groups: Collection[str] = (),
    on_result: Callable[[CaseResult], None] = lambda _result: None,
) -> list[CaseResult]:
    """Run every case, or those of some groups; `on_result` is called with each as it ends.

    Raises BenchFaultError when the device does not answer at the beginning, or is lost between two cases;
    UnusableInputError for a drive with power.
    """
    _check_ready(dut)
    try:
        return _examine_all(dut, groups, on_result)
    except CaseEndedError as error:
        last = dut.steps[-1]
        text = f"{last.what}: expected {last.expected}, seen {last.seen}"
        raise BenchFaultError(f"node {dut.node_id} can't be examined: {text}") from error


def _examine_all(
    dut: DeviceUnderTest, groups: Collection[str], on_result: Callable[[CaseResult], None]
) -> list[CaseResult]:
    before = snapshot(dut)
    power_on = _at_power_on(dut, before) if dut.allowed.store else None
    results: list[CaseResult] = []
    lost: list[Step] = []
    try:
        for case in listed_cases():
            if groups and case.group not in groups:
                continue
            for result in _of_each_axis(dut, case):
                lost += _as_steps(f"after {result.name}", restore(dut, before))
                results.append(result)
                on_result(result)
    finally:
        lost += _as_steps("at the end", _leave(dut, before, power_on))
    results.append(_afterwards(lost, len(before)))
    on_result(results[-1])
    return results


def _of_each_axis(dut: DeviceUnderTest, case: Case) -> Iterator[CaseResult]:
    """A case of CiA 402 for each axis of the device; of CiA 301 once."""
    several = len(dut.eds.axes) > 1 and case.name in OF_DRIVES
    for axis in dut.eds.axes if several else [None]:
        dut.eds.axis = axis or 1
        result = replace(_examine(dut, case), axis=axis)
        dut.eds.axis = 1
        yield result


def _as_steps(when: str, lost: Collection[Lost]) -> list[Step]:
    return [Step(f"{when}: {one.name}", "", one.was, one.found, False) for one in lost]


def _afterwards(lost: list[Step], compared: int) -> CaseResult:
    if not lost:
        whole = Step(f"{compared} parameters compared", "", "as they were", "as they were", True)
        return _result(AFTERWARDS, Verdict.PASSED, "", [whole])
    reason = f"{lost[0].what}: was {lost[0].expected}, is {lost[0].seen}"
    return _result(AFTERWARDS, Verdict.FAILED, reason, lost)


def _check_ready(dut: DeviceUnderTest) -> None:
    if not isinstance(dut.peek(0x1000, 0), bytes):
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # one that is STOPPED has no SDO
        if not isinstance(dut.peek(0x1000, 0), bytes):
            raise BenchFaultError(f"node {dut.node_id}: no answer to an SDO read of 1000h")
    for _ in dut.eds.each_axis():
        state = shown_state(dut) if dut.eds.is_drive else None
        if state in POWERED:
            raise UnusableInputError(f"node {dut.node_id}", f"is in {state.label}, expected a drive without power")
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)


def _at_power_on(dut: DeviceUnderTest, before: Values) -> Values:
    """Stored parameters of the device: its values after a reset."""
    dut.reset()
    stored = snapshot(dut)
    restore(dut, before)
    return stored


def _leave(dut: DeviceUnderTest, before: Values, power_on: Values | None) -> list[Lost]:
    """Restore the values found, and the stored ones."""
    dut.begin()
    if power_on is not None and dut.eds.can_write(0x1010, 1):
        dut.was_reset = True
        restore(dut, power_on)
        dut.try_to_write(0x1010, 1, b"save")
    dut.was_reset = True
    return restore(dut, before)


def _examine(dut: DeviceUnderTest, case: Case) -> CaseResult:
    dut.begin()
    verdict, reason = Verdict.PASSED, ""
    try:
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        dut.begin()
        CASES[case.name](dut)
    except NotApplicableError as error:
        verdict, reason = Verdict.NOT_APPLICABLE, str(error)
    except NotAllowedError as error:
        verdict, reason = Verdict.NOT_ALLOWED, str(error)
    except CaseEndedError:
        verdict, reason = Verdict.FAILED, "the case could not go on"
    except (BenchFaultError, UnusableInputError):
        raise  # the bus is lost: there is nothing to go on with
    except Exception as error:  # of one case: the others are examined all the same
        verdict, reason = Verdict.FAILED, f"unexpected {type(error).__name__}: {error}"
    wrong = [step for step in dut.steps if not step.ok]
    if wrong:
        first = wrong[0]
        verdict, reason = Verdict.FAILED, f"{first.what}: expected {first.expected}, seen {first.seen}"
    elif verdict is Verdict.PASSED and not dut.steps:
        verdict, reason = Verdict.NOT_APPLICABLE, dut.notes[0] if dut.notes else "nothing to examine"
    result = _result(case, verdict, reason, dut.steps, dut.notes)
    dut.begin()
    return result


def _result(
    case: Case, verdict: Verdict, reason: str, steps: Collection[Step], notes: Collection[str] = ()
) -> CaseResult:
    return CaseResult(case.group, case.number, case.title, case.clause, verdict, reason, tuple(steps), tuple(notes))
