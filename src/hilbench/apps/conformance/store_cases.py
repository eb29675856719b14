"""Store, restore and identifier cases (CiA 301, 7.5.2.13, 7.5.2.14, table 40). Storing has to be allowed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import CaseEndedError, NotApplicableError
from hilbench.canopen.identifiers import COB_ID, INVALID, is_restricted
from hilbench.canopen.object_store import (
    CANNOT_STORE,
    GENERAL_ERROR,
    INVALID_VALUE,
    PRESENT_STATE,
    VALUE_TOO_HIGH,
    VALUE_TOO_LOW,
)
from hilbench.canopen.sdo_client import Refusal

_SAVE, _LOAD, _WRONG = b"save", b"load", b"nowr"
_DENIED: Final = (CANNOT_STORE, GENERAL_ERROR, PRESENT_STATE, INVALID_VALUE)
#: Parameters that may have another value for a while, and one that they don't have by default.
_CHANGES: Final = {(0x1017, 0): 20_000, (0x1015, 0): 1000, (0x1016, 1): 0x7D2710}
STORE, RESTORE = 0x1010, 0x1011


def store(dut: DeviceUnderTest, part: int, index: int = STORE, signature: bytes = _SAVE) -> None:
    """Write the signature, which has to be taken."""
    dut.write(index, part, int.from_bytes(signature, "little"))


def _prepared(dut: DeviceUnderTest, index: int, part: int) -> dict[tuple[int, int], int]:
    """Parameters with other values than before; what they were."""
    dut.needs_to_write((index, part), (STORE, part))
    changes = {key: value for key, value in _CHANGES.items() if dut.eds.can_write(*key)}
    if not changes:
        raise NotApplicableError("no parameter (1015h, 1016h, 1017h) can be written by the EDS file")
    dut.needs_store()
    before = {key: dut.value(*key) for key in changes}
    for key, value in changes.items():
        dut.write(*key, value)
    return before


def _are(dut: DeviceUnderTest, what: str, values: Mapping[tuple[int, int], int]) -> None:
    for (index, sub), value in values.items():
        dut.reads(f"{index:04X}h:{sub} {what}", index, sub, value)


def _changed(before: Mapping[tuple[int, int], int]) -> dict[tuple[int, int], int]:
    return {key: _CHANGES[key] for key in before}


def save_with_wrong_signature(dut: DeviceUnderTest, part: int) -> None:
    """Refused, and not stored."""
    dut.needs_to_write((STORE, part))
    dut.needs_store()
    dut.reset()
    before = _prepared(dut, STORE, part)
    dut.refuses("a wrong signature", STORE, part, _WRONG, *_DENIED)
    dut.reset()
    _are(dut, "is not stored", before)


def save(dut: DeviceUnderTest, part: int) -> dict[tuple[int, int], int]:
    """Stored, and there after a reset."""
    before = _prepared(dut, STORE, part)
    store(dut, part)
    dut.reset()
    _are(dut, "is stored", _changed(before))
    return before


def restore_with_wrong_signature(dut: DeviceUnderTest, part: int) -> None:
    """Refused, and what was stored stays."""
    dut.needs_to_write((RESTORE, part))
    before = save(dut, part)
    dut.refuses("a wrong signature", RESTORE, part, _WRONG, *_DENIED)
    dut.reset()
    _are(dut, "is still stored", _changed(before))


def restore(dut: DeviceUnderTest, part: int) -> None:
    """The defaults act after the reset."""
    dut.needs_to_write((RESTORE, part))
    before = save(dut, part)
    store(dut, part, RESTORE, _LOAD)
    _are(dut, "stays until the reset", _changed(before))
    dut.reset()
    entries = {key: dut.eds.entry(*key).default for key in before}
    defaults = {key: int.from_bytes(data, "little") for key, data in entries.items() if data is not None}
    _are(dut, "has its default", defaults)


def verify_configuration(dut: DeviceUnderTest) -> None:
    """1020h is stored with the rest."""
    dut.needs_to_write((0x1020, 1), (0x1020, 2), (STORE, 1))
    dut.needs_store()
    values = {(0x1020, 1): 0x1234, (0x1020, 2): 0x5678}
    for key, value in values.items():
        dut.write(*key, value)
    store(dut, 1)
    dut.reset()
    _are(dut, "is stored", values)


def restricted_identifiers(dut: DeviceUnderTest) -> None:
    """No service takes an identifier of another (table 40)."""
    keys = [(0x1014, 0)] + [(base, 1) for base in (0x1400, 0x1800)]
    keys = [key for key in keys if dut.eds.can_write(*key)]
    if dut.eds.can_write(0x1005):
        keys.insert(0, (0x1005, 0))
    if not keys:
        raise NotApplicableError("no COB-ID can be written by the EDS file")
    for index, sub in keys:
        _refuses_restricted(dut, index, sub)


def _refuses_restricted(dut: DeviceUnderTest, index: int, sub: int) -> None:
    in_use = dut.value(index, sub)
    if index != 0x1005:  # SYNC has no bit that makes it invalid
        dut.configure(index, sub, in_use | INVALID, "made invalid")
    codes = (INVALID_VALUE, VALUE_TOO_HIGH, VALUE_TOO_LOW)
    wrong = []
    for cob_id in (each for each in range(COB_ID + 1) if is_restricted(each) and each not in (0x080, 0x7FF)):
        answer = dut.try_to_write(index, sub, cob_id.to_bytes(4, "little"))
        if answer is None:
            dut.check(f"{cob_id:03X}h to {index:04X}h:{sub}", "an answer", "nothing", False)
            raise CaseEndedError
        if not (isinstance(answer, Refusal) and answer.code in codes):
            wrong.append(f"{cob_id:03X}h {answer if isinstance(answer, Refusal) else 'taken'}")
            dut.try_to_write(index, sub, (in_use | (INVALID if index != 0x1005 else 0)).to_bytes(4, "little"))
    seen = ", ".join(wrong[:8]) + (f" … ({len(wrong)})" if len(wrong) > 8 else "")
    dut.check(
        f"restricted COB-IDs to {index:04X}h:{sub}",
        f"each refused, {INVALID_VALUE:08X}h",
        seen or "each refused",
        not wrong,
    )


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], object]]] = {
    **{
        f"Store and restore {4 * (part - 1) + number}": partial(case, part=part)
        for part in (1, 2)
        for number, case in enumerate((save_with_wrong_signature, save, restore_with_wrong_signature, restore), 1)
    },
    "Store and restore 9": verify_configuration,
    "Store and restore 10": restricted_identifiers,
}
