"""PDOs as cases use them: one of the device's own, with an object in it that a case can change without moving anything.

The object of a drive's TPDO is the statusword, which changes by transitions 2 and 7 (no power stage is on in READY TO
SWITCH ON); that of its RPDO is the controlword. Of other devices it is a parameter that may be mapped and written.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from hilbench.apps.conformance.description import Entry, Pdo
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import NotApplicableError, some
from hilbench.canopen.identifiers import COB_ID, INVALID, MAPPING, NO_REMOTE_REQUEST
from hilbench.cia402.objects import CONTROLWORD, STATUSWORD
from hilbench.cia402.state_machine import Command

RPDO, TPDO = 0x1400, 0x1800
_DEFAULT_IDS: Final = {RPDO: (0x200, 0x300, 0x400, 0x500), TPDO: (0x180, 0x280, 0x380, 0x480)}


def transmit_pdo(dut: DeviceUnderTest) -> Pdo:
    """A TPDO with what `change` changes in it. Raises NotApplicableError when the device can't have one."""
    if dut.eds.is_drive:
        return _pdo(dut, TPDO, dut.eds.entry(STATUSWORD))
    return _pdo(dut, TPDO, _mappable(dut, "a TPDO", ("rw", "rwr")))


def receive_pdo(dut: DeviceUnderTest) -> Pdo:
    """An RPDO with an output in it. Raises NotApplicableError when the device can't have one, NotAllowedError when it
    would be an output of something else than a drive, and nothing may move.
    """
    if dut.eds.is_drive:
        return _pdo(dut, RPDO, dut.eds.entry(CONTROLWORD))
    output = _mappable(dut, "an RPDO", ("rw", "rww"))
    dut.needs_motion(f"writes {output}, an output")
    return _pdo(dut, RPDO, output)


def _mappable(dut: DeviceUnderTest, what: str, access: Sequence[str]) -> Entry:
    found = [e for e in dut.eds.entries(0x2000) if e.variable.pdo_mappable and e.access in access and e.is_integer]
    return some(found, f"no object that may be mapped to {what} can be written by the EDS file")[0]


def _pdo(dut: DeviceUnderTest, base: int, entry: Entry) -> Pdo:
    what = "RPDO" if base == RPDO else "TPDO"
    numbers = [number for number in dut.eds.pdos(base) if dut.eds.can_write(base + number, 1)]
    number = some(numbers, f"a {what} whose COB-ID can be written is not in the EDS file")[0]
    index = base + number
    cob_id = dut.value(index, 1) & COB_ID
    if cob_id == 0:
        cob_id = _DEFAULT_IDS[base][number % 4] + dut.node_id
    dut.pdo = Pdo(index, cob_id, entry)
    if not dut.eds.can_write(index + MAPPING, 0) and mapped(dut, index) != [entry.mapping]:
        raise NotApplicableError(f"{index + MAPPING:04X}h can't be written by the EDS file, and maps something else")
    return dut.pdo


def mapped(dut: DeviceUnderTest, index: int) -> list[int]:
    """The entries of a PDO's mapping."""
    return [dut.value(index + MAPPING, sub) for sub in range(1, dut.value(index + MAPPING, 0) + 1)]


def set_up(
    dut: DeviceUnderTest, kind: int, *, inhibit: int = 0, event_ms: int = 0, start: int = 0, remote: bool = False
) -> None:
    """Set up the case's PDO as in CiA 301, 7.5.2.36: invalid, mapping, parameters, valid. Inhibit time in 100 µs.

    Raises NotApplicableError for what the device lacks or refuses: which of them it has is its maker's choice.
    """
    pdo = dut.pdo
    index = pdo.index
    flags = NO_REMOTE_REQUEST if index >= TPDO and not remote else 0
    dut.write(index, 1, INVALID | flags | pdo.cob_id)
    if dut.eds.can_write(index + MAPPING, 0):
        map_objects(dut, index, [pdo.carries.mapping])
    dut.configure(index, 2, kind, f"transmission type {kind}")
    for sub, value, what in (
        (3, inhibit, "inhibit time"),
        (5, event_ms, "event timer"),
        (6, start, "SYNC start value"),
    ):
        if value and not dut.eds.can_write(index, sub):
            raise NotApplicableError(f"no {what} ({index:04X}h:{sub}) in the EDS file")
        if dut.eds.can_write(index, sub) and index >= TPDO:
            dut.configure(index, sub, value, what)
    if remote:
        dut.configure(index, 1, pdo.cob_id, "remote requests allowed")
        return
    dut.write(index, 1, flags | pdo.cob_id)


def map_objects(dut: DeviceUnderTest, index: int, entries: Sequence[int]) -> None:
    """Into a PDO that is invalid."""
    dut.write(index + MAPPING, 0, 0)
    for sub, entry in enumerate(entries, 1):
        dut.write(index + MAPPING, sub, entry)
    dut.write(index + MAPPING, 0, len(entries))


def change(dut: DeviceUnderTest) -> None:
    """Change what the case's TPDO carries."""
    if dut.eds.is_drive:
        before = dut.value(STATUSWORD) & 0x6F
        dut.write(CONTROLWORD, 0, (Command.DISABLE_VOLTAGE if before == 0x21 else Command.SHUTDOWN).value)
        return
    index, sub = dut.pdo.carries.key
    dut.write(index, sub, dut.value(index, sub) ^ 1)
