"""Actions of cases about storing and about identifiers (CiA 301, 7.5.2.13, 7.5.2.14, table 40)."""

from __future__ import annotations

from hilbench.apps.conformance.actions import Key, action
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import CaseEndedError, NotApplicableError
from hilbench.canopen.identifiers import COB_ID, INVALID, is_restricted
from hilbench.canopen.object_store import INVALID_VALUE, VALUE_TOO_HIGH, VALUE_TOO_LOW
from hilbench.canopen.sdo_client import Refusal


@action
def sign(dut: DeviceUnderTest, key: Key, signature: str) -> None:
    """Write the signature "save" or "load", which has to be taken."""
    dut.write(*key, int.from_bytes(signature.encode("ascii"), "little"))


@action
def restricted_identifiers(dut: DeviceUnderTest) -> None:
    """No service takes an identifier of another (table 40)."""
    keys = [key for key in ((0x1005, 0), (0x1014, 0), (0x1400, 1), (0x1800, 1)) if dut.eds.can_write(*key)]
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
