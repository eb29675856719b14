"""Actions of EMCY cases (CiA 301, 7.2.7): an RPDO that is too short makes the device report 8210h."""

from __future__ import annotations

from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest, answer_text
from hilbench.apps.conformance.process_data import receive_pdo, set_up
from hilbench.canopen.identifiers import NmtCommand
from hilbench.canopen.object_store import GENERAL_ERROR, NO_DATA
from hilbench.canopen.sdo_client import Refusal

_TOO_SHORT: Final = "10 82"
_SOON_S: Final = 0.1


@action
def error_register(dut: DeviceUnderTest) -> None:
    """1001h is 0 without an error; with one (1003h:0) it is not."""
    errors = dut.value(0x1003, 0) if dut.eds.has(0x1003) else 0
    dut.ask("read 1001h:0", "40 01 10 00 00000000", "4f 01 10 00 00 ??????" if not errors else "4f 01 10 00 ?? ??????")
    if errors:
        dut.notes.append(f"1003h:0 tells of {errors} errors")


@action
def error_history(dut: DeviceUnderTest) -> None:
    """Without an error the history has no entry."""
    count = dut.value(0x1003, 0)
    seen = dut.peek(0x1003, 1)
    if count:
        ok = isinstance(seen, bytes) and len(seen) == 4
        dut.check(f"read 1003h:1, {count} errors", "4 bytes", answer_text(seen), ok)
    else:
        ok = isinstance(seen, Refusal) and seen.code in (NO_DATA, GENERAL_ERROR)
        dut.check("read 1003h:1, no error", f"abort {NO_DATA:08X}h", answer_text(seen), ok)


@action
def sound_rpdo(dut: DeviceUnderTest) -> None:
    """RPDO in OPERATIONAL that was received once correctly: an earlier error would not be reported again."""
    dut.needs((0x1014, 0))
    receive_pdo(dut)
    set_up(dut, 255)
    dut.nmt(NmtCommand.START)
    _send_rpdo(dut)
    dut.receive(_SOON_S)


@action
def short_rpdo(dut: DeviceUnderTest) -> int:
    """Check that the EMCY of a too short RPDO comes, and return its error register (1001h)."""
    dut.forget()
    dut.send(dut.pdo.cob_id)
    found = dut.hear_until(dut.emergency_id, _SOON_S)
    dut.must(dut.frames("an RPDO without data", found, dut.emergency_id, f"{_TOO_SHORT} ?? ??????????"))
    return next(received.data[2] for received in found if received.can_id == dut.emergency_id)


def _send_rpdo(dut: DeviceUnderTest) -> None:
    """The RPDO with what its object has (of a drive: no command)."""
    key = dut.pdo.carries.key
    dut.touched.add(key)
    value = 0 if dut.eds.is_drive else dut.value(*key)
    dut.send(dut.pdo.cob_id, value.to_bytes(dut.pdo.size, "little"))


@action
def register_after_short_rpdo(dut: DeviceUnderTest) -> None:
    """1001h is as in the message: an error, until an RPDO of the right length comes; then EMCY 0000h is sent."""
    if not short_rpdo(dut):
        dut.notes.append("the device reports the error once, and has none in 1001h")
        dut.reads("1001h as in the message", 0x1001, 0, 0)
        return
    dut.reads_bits("1001h: generic and communication error", 0x1001, 0, 0x11)
    emergency_id = dut.emergency_id
    _send_rpdo(dut)
    found = dut.hear_until(emergency_id, _SOON_S)
    dut.frames("an RPDO of the right length", found, dut.emergency_id, "00 00 ?? ??????????")
    dut.reads("1001h is 0 again", 0x1001, 0, 0)
