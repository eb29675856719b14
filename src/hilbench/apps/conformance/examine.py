"""The whole examination: every case, and the device as it was before.

After each case the parameters that it wrote, and after a reset all that differ, are written back; at the end all of
them are compared. Where storing is allowed, what the device had at power-on is stored again. Objects of the
communication profile come first, a PDO by the procedure of CiA 301 (invalid, nothing mapped, entries, number,
parameters, valid). Outputs and commands (process data) are no parameters: a drive is without power afterwards.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Iterator
from dataclasses import replace
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest, answer_text
from hilbench.apps.conformance.listing import ListedCase, listed_cases
from hilbench.apps.conformance.pdo_cases import RPDO, TPDO
from hilbench.apps.conformance.power import at_rest, shown_state
from hilbench.apps.conformance.record import (
    Case,
    CaseEndedError,
    CaseResult,
    NotAllowedError,
    NotApplicableError,
    Step,
    Verdict,
)
from hilbench.canopen.identifiers import INVALID, MAPPING, NmtCommand
from hilbench.canopen.object_store import PRESENT_STATE
from hilbench.canopen.sdo_client import Refusal
from hilbench.cia402.axis import of_first_axis
from hilbench.cia402.state_machine import POWERED
from hilbench.errors import BenchFaultError, UnusableInputError

#: Commands, not parameters: they are not written back.
_COMMANDS: Final = (0x1003, 0x1010, 0x1011, *range(0x1F50, 0x1F60), 0x6040)
_SYNC_PERIOD, _SYNC_COUNTER = (0x1006, 0), (0x1019, 0)
_PDO_PARAMETERS: Final = (2, 3, 5, 6)

Values = dict[tuple[int, int], bytes]
AFTERWARDS: Final = Case("Afterwards", 1, "Every parameter is what it was before", "no case of a standard")


def snapshot(dut: DeviceUnderTest) -> Values:
    """Every parameter that can be read and written."""
    found = (entry for entry in dut.eds.entries() if entry.writable and of_first_axis(entry.index) not in _COMMANDS)
    return {entry.key: data for entry in found if isinstance(data := dut.peek(*entry.key), bytes)}


def restore(dut: DeviceUnderTest, values: Values, when: str = "") -> list[Step]:
    """Write back what was touched (after a reset: all), in PRE-OPERATIONAL. Returns what could not be."""
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    for _ in dut.eds.each_axis():
        at_rest(dut)
    keys = set(values) if dut.was_reset else {key for key in dut.touched if key in values}
    differing = {key for key in keys if dut.peek(*key) != values[key]}
    for pdo in sorted({index for key in differing if (index := _pdo_of(key[0])) is not None}):
        _restore_pdo(dut, pdo, values)
    parameters = [key for key in differing if _pdo_of(key[0]) is None]
    if _SYNC_COUNTER in parameters and _SYNC_PERIOD in values:
        dut.try_to_write(*_SYNC_PERIOD, bytes(4))  # while it is not 0 the counter stays as it is
        parameters.append(_SYNC_PERIOD)
    if any(index == 0x1016 for index, _ in parameters):
        for key in [key for key in parameters if key[0] == 0x1016]:
            dut.try_to_write(*key, bytes(4))  # two entries never watch one node
    for key in sorted(set(parameters), key=lambda key: (key == _SYNC_PERIOD, key)):
        answer = dut.try_to_write(*key, values[key])
        if isinstance(answer, Refusal) and answer.code == PRESENT_STATE and key == (0x1014, 0):
            dut.try_to_write(*key, ((dut.number(*key) or 0) | INVALID).to_bytes(4, "little"))
            dut.try_to_write(*key, values[key])
    lost = [
        Step(f"{when}: {dut.eds.entry(index, sub)}", "", values[index, sub].hex(" "), answer_text(found), False)
        for index, sub in sorted(differing)
        if (found := dut.peek(index, sub)) != values[index, sub]
    ]
    dut.touched.clear()
    dut.was_reset = False
    return lost


def _pdo_of(index: int) -> int | None:
    """Index of the communication parameters of the PDO that an object belongs to."""
    for base in (RPDO, TPDO):
        if base <= index < base + 2 * MAPPING:
            return index - MAPPING if index >= base + MAPPING else index
    return None


def _restore_pdo(dut: DeviceUnderTest, index: int, values: Values) -> None:
    cob_id = values.get((index, 1))
    if cob_id is None:
        return
    former = int.from_bytes(cob_id, "little")
    for present in (dut.number(index, 1), former):
        dut.try_to_write(index, 1, ((former if present is None else present) | INVALID).to_bytes(4, "little"))
    mapping = index + MAPPING
    count = values.get((mapping, 0))
    if count is not None:
        dut.try_to_write(mapping, 0, b"\0")
        for sub in sorted(sub for at, sub in values if at == mapping and sub):
            dut.try_to_write(mapping, sub, values[mapping, sub])
        dut.try_to_write(mapping, 0, count)
    for sub in _PDO_PARAMETERS:
        if (index, sub) in values:
            dut.try_to_write(index, sub, values[index, sub])
    dut.try_to_write(index, 1, cob_id)


def examine(dut: DeviceUnderTest, groups: Collection[str] = ()) -> Generator[CaseResult]:
    """Run every case, or those of some groups, one after the other. What comes after the last one is done as well when
    the iterator is closed before.

    Raises BenchFaultError when the device does not answer at the beginning, or is lost between two cases;
    UnusableInputError for a drive with power.
    """
    _check_ready(dut)
    try:
        before = snapshot(dut)
        power_on = _at_power_on(dut, before) if dut.store else None
        lost: list[Step] = []
        try:
            for case in listed_cases():
                if groups and case.group not in groups:
                    continue
                for result in _of_each_axis(dut, case):
                    lost += restore(dut, before, f"after {result.name}")
                    if result.verdict is Verdict.FAILED:
                        _check_answers(dut)
                    yield result
        finally:
            lost += _leave(dut, before, power_on)
        yield _afterwards(lost, len(before))
    except CaseEndedError as error:
        last = dut.steps[-1]
        text = f"{last.what}: expected {last.expected}, seen {last.seen}"
        raise BenchFaultError(f"node {dut.node_id} can't be examined: {text}") from error


def _of_each_axis(dut: DeviceUnderTest, case: ListedCase) -> Iterator[CaseResult]:
    """A case of CiA 402 for each axis of the device; of CiA 301 once."""
    several = len(dut.eds.axes) > 1 and case.of_drives
    for axis in dut.eds.each_axis() if several else [None]:
        yield replace(_examine(dut, case), axis=axis)


def _afterwards(lost: list[Step], compared: int) -> CaseResult:
    if not lost:
        whole = Step(f"{compared} parameters compared", "", "as they were", "as they were", True)
        return _result(AFTERWARDS, Verdict.PASSED, "", [whole])
    reason = f"{lost[0].what}: was {lost[0].expected}, is {lost[0].seen}"
    return _result(AFTERWARDS, Verdict.FAILED, reason, lost)


def _check_answers(dut: DeviceUnderTest) -> None:
    if not isinstance(dut.peek(0x1000, 0), bytes):
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # one that is STOPPED has no SDO
        if not isinstance(dut.peek(0x1000, 0), bytes):
            raise BenchFaultError(f"node {dut.node_id}: no answer to an SDO read of 1000h")


def _check_ready(dut: DeviceUnderTest) -> None:
    _check_answers(dut)
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


def _leave(dut: DeviceUnderTest, before: Values, power_on: Values | None) -> list[Step]:
    """Restore the values found, and the stored ones."""
    dut.begin()
    if power_on is not None and dut.eds.can_write(0x1010, 1):
        dut.was_reset = True
        restore(dut, power_on)
        dut.try_to_write(0x1010, 1, b"save")
    dut.was_reset = True
    return restore(dut, before, "at the end")


def _examine(dut: DeviceUnderTest, case: ListedCase) -> CaseResult:
    dut.begin()
    verdict, reason = Verdict.PASSED, ""
    try:
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        dut.begin()
        case.examine(dut)
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
