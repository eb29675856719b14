"""Actions of cases of NMT, EMCY, SYNC, heartbeat, node guarding and stored parameters (CiA 301)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from hilbench.apps.conformance.actions import Key
from hilbench.apps.conformance.dut import DeviceUnderTest, answer_text
from hilbench.apps.conformance.pdo_cases import receive_pdo, set_up, transmit_pdo
from hilbench.apps.conformance.record import NotAllowedError, NotApplicableError, some
from hilbench.apps.conformance.wire import periods, steady
from hilbench.can.frame import REMOTE_FLAG, Frame
from hilbench.canopen.identifiers import (
    COB_ID,
    HEARTBEAT,
    INVALID,
    NMT,
    PRODUCE_SYNC,
    SYNC,
    NmtCommand,
    NmtState,
    is_restricted,
)
from hilbench.canopen.object_store import (
    GENERAL_ERROR,
    INCOMPATIBLE,
    INVALID_VALUE,
    NO_DATA,
    VALUE_TOO_HIGH,
    VALUE_TOO_LOW,
)
from hilbench.canopen.sdo_client import Refusal

_AFTER_COMMAND_S: Final = 0.05
_TOO_SHORT: Final = "10 82"
_SOON_S: Final = 0.1
_PRODUCED_US: Final = 100_000
_LOST: Final = "30 81 ?? ??????????"
_WATCHED_MS: Final = 200
_PRE_OPERATIONAL: Final = NmtState.PRE_OPERATIONAL.heartbeat
_MOST_ENTRIES: Final = 4


def pdos_act(dut: DeviceUnderTest, state: NmtCommand, act: bool) -> None:
    """Check whether SYNC triggers a TPDO, and an RPDO acts."""
    try:
        pdo = transmit_pdo(dut)
    except NotApplicableError as error:
        dut.notes.append(str(error))
    else:
        set_up(dut, 1)
        dut.nmt(state)
        dut.forget()
        dut.frames("SYNC", dut.sync(), pdo.cob_id, *(["??" * pdo.size] if act else []))
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    if not dut.eds.is_drive:
        return
    try:
        pdo = receive_pdo(dut)
    except (NotApplicableError, NotAllowedError) as error:
        dut.notes.append(str(error))
        return
    set_up(dut, 1)
    dut.write(0x6040, 0, 0)
    dut.nmt(state)
    dut.send(pdo.cob_id, b"\x06\x00")
    dut.sync()
    if state is NmtCommand.STOP:
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)  # where SDO is possible again
    dut.reads("controlword after an RPDO with 6", 0x6040, 0, 6 if act else 0)
    dut.write(0x6040, 0, 0)


def no_sdo(dut: DeviceUnderTest) -> None:
    """Expect that SDO is not answered."""
    answer = dut.exchange(bytes.fromhex("4000100000000000"))
    dut.check("read 1000h:0", "no answer", "no answer" if answer is None else answer.hex(" "), answer is None)


def commands_without_effect(dut: DeviceUnderTest) -> None:
    """Commands for another node, unknown, or too short change nothing."""
    for data in (bytes((1, dut.node_id % 127 + 1)), bytes((0x77, dut.node_id)), bytes((1,))):
        dut.send(NMT, data)
        dut.receive(_AFTER_COMMAND_S)
        dut.shows(NmtState.PRE_OPERATIONAL)


def error_register(dut: DeviceUnderTest) -> None:
    """1001h is 0 without an error; with one (1003h:0) it is not."""
    errors = dut.value(0x1003, 0) if dut.eds.has(0x1003) else 0
    dut.ask("read 1001h:0", "40 01 10 00 00000000", "4f 01 10 00 00 ??????" if not errors else "4f 01 10 00 ?? ??????")
    if errors:
        dut.notes.append(f"1003h:0 tells of {errors} errors")


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


def sound_rpdo(dut: DeviceUnderTest) -> None:
    """RPDO in OPERATIONAL that was received once correctly: an earlier error would not be reported again."""
    dut.needs([(0x1014, 0)])
    receive_pdo(dut)
    set_up(dut, 255)
    dut.nmt(NmtCommand.START)
    _send_rpdo(dut)
    dut.receive(_SOON_S)


def short_rpdo(dut: DeviceUnderTest) -> int:
    """Check that the EMCY of a too short RPDO comes, and return its error register (1001h)."""
    dut.forget()
    dut.send(dut.pdo.cob_id)
    found = dut.receive_until(dut.emergency_id, _SOON_S)
    dut.must(dut.frames("an RPDO without data", found, dut.emergency_id, f"{_TOO_SHORT} ?? ??????????"))
    return next(received.data[2] for received in found if received.can_id == dut.emergency_id)


def _send_rpdo(dut: DeviceUnderTest) -> None:
    """The RPDO with what its object has (of a drive: no command)."""
    key = dut.pdo.carries.key
    dut.touched.add(key)
    value = 0 if dut.eds.is_drive else dut.value(*key)
    dut.send(dut.pdo.cob_id, value.to_bytes(dut.pdo.size, "little"))


def register_after_short_rpdo(dut: DeviceUnderTest) -> None:
    """1001h is as in the message: an error, until an RPDO of the right length comes; then EMCY 0000h is sent."""
    if not short_rpdo(dut):
        dut.notes.append("the device reports the error once, and has none in 1001h")
        dut.reads("1001h as in the message", 0x1001, 0, 0)
        return
    answer = dut.peek(0x1001, 0)
    ok = isinstance(answer, bytes) and int.from_bytes(answer, "little") & 0x11 == 0x11
    dut.check("1001h: generic and communication error", "bits 11h", answer_text(answer), ok)
    emergency_id = dut.emergency_id
    _send_rpdo(dut)
    found = dut.receive_until(emergency_id, _SOON_S)
    dut.frames("an RPDO of the right length", found, dut.emergency_id, "00 00 ?? ??????????")
    dut.reads("1001h is 0 again", 0x1001, 0, 0)


def produce_sync(dut: DeviceUnderTest) -> None:
    """SYNC with a period of 100 ms. Raises NotApplicableError for a device that is no producer."""
    dut.needs_to_write([(0x1005, 0), (0x1006, 0)])
    dut.configure(0x1006, 0, 0, "no period")
    dut.configure(0x1005, 0, PRODUCE_SYNC | SYNC, "the device is no SYNC producer")
    dut.configure(0x1006, 0, _PRODUCED_US, "a period of 100 ms")
    dut.forget()


def every_tenth_sync(dut: DeviceUnderTest) -> None:
    """Transmission type 10: with every tenth SYNC, whichever the device counts from."""
    came = [number for number in range(1, 41) if dut.sync_brings(dut.pdo.cob_id)]
    wanted = list(range(came[0], 41, 10)) if came and came[0] <= 10 else [10, 20, 30, 40]
    dut.check("40 SYNCs, type 10", f"sent with {wanted}", f"sent with {came or 'none'}", came == wanted)


def produces_sync_counter(dut: DeviceUnderTest) -> None:
    """1 to 5, and again."""
    seen = [received.data.hex() for received in dut.receive_id(SYNC, 1.0)][:7]
    first = int(seen[0], 16) if seen and seen[0] else 1
    wanted = [f"{(first - 1 + number) % 5 + 1:02x}" for number in range(len(seen))]
    dut.check(
        "counter up to 5", " ".join(wanted) or "a counter", " ".join(seen) or "nothing", bool(seen) and seen == wanted
    )


def sign(dut: DeviceUnderTest, key: Key, signature: str) -> None:
    """Write the signature "save" or "load", which has to be taken."""
    dut.write(*key, int.from_bytes(signature.encode("ascii"), "little"))


def restricted_identifiers(dut: DeviceUnderTest) -> None:
    """No service takes an identifier of another (table 40)."""
    keys = [key for key in ((0x1005, 0), (0x1014, 0), (0x1400, 1), (0x1800, 1)) if dut.eds.can_write(*key)]
    for index, sub in some(keys, "no COB-ID can be written by the EDS file"):
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
            dut.must(dut.check(f"{cob_id:03X}h to {index:04X}h:{sub}", "an answer", "nothing", False))
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


def heartbeats_beside_requests(dut: DeviceUnderTest) -> None:
    """Remote requests bring nothing, and move no heartbeat."""
    dut.forget()
    found: list[Frame] = []
    for _ in range(7):
        dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
        found += dut.receive_id(HEARTBEAT + dut.node_id, 0.3)
    ok = len(found) in (4, 5) and steady(found, 0.5)
    seen = f"{len(found)}{periods(found)}"
    dut.check("requests every 300 ms", "4 or 5 heartbeats in 2.1 s", seen, ok)


# -- consumer --------------------------------------------------------------------------------------------------


def _entries(dut: DeviceUnderTest) -> list[int]:
    found = [entry.sub for entry in dut.eds.entries(0x1016, 0x1016) if entry.sub and entry.writable]
    return some(found, "1016h:1 is not in the EDS file, to be written")[:_MOST_ENTRIES]


def _watch(dut: DeviceUnderTest, entry: int, node: int, time_ms: int = _WATCHED_MS) -> None:
    dut.write(0x1016, entry, node << 16 | time_ms)


def _beat(dut: DeviceUnderTest, node: int) -> None:
    dut.send(HEARTBEAT + node, _PRE_OPERATIONAL)


def watched_once(dut: DeviceUnderTest) -> None:
    """A node that one entry watches can't be watched by another."""
    first, *others = _entries(dut)
    if not others:
        raise NotApplicableError("1016h has one entry only")
    node = dut.strangers(0.2)[0]
    _watch(dut, first, node)
    value = (node << 16 | _WATCHED_MS).to_bytes(4, "little")
    dut.refuses("the same node in another entry", 0x1016, others[0], value, INCOMPATIBLE)


def _watched(dut: DeviceUnderTest) -> Iterator[tuple[int, int]]:
    """Each entry while it watches a node that is not there, and that node."""
    for entry, node in zip(_entries(dut), dut.strangers(0.2), strict=False):
        _watch(dut, entry, node)
        dut.forget()
        yield entry, node
        dut.write(0x1016, entry, 0)
        dut.forget()


def received_in_time(dut: DeviceUnderTest) -> None:
    """No EMCY while heartbeats come."""
    for entry, node in _watched(dut):
        dut.nmt(NmtCommand.START)
        dut.forget()
        found: list[Frame] = []
        for _ in range(5):
            _beat(dut, node)
            found += dut.receive(_WATCHED_MS * 0.6e-3)
        dut.frames(f"entry {entry}: heartbeats in time", found, dut.emergency_id)
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)


def missed(dut: DeviceUnderTest) -> None:
    """EMCY 8130h when they stay away."""
    for entry, node in _watched(dut):
        _beat(dut, node)
        found = dut.receive(2.5e-3 * _WATCHED_MS)
        dut.frames(f"entry {entry}: no heartbeat any more", found, dut.emergency_id, _LOST)


def reset_ends_watch(dut: DeviceUnderTest) -> None:
    """The consumer time begins with the first heartbeat; after a reset no node is missed that was not received
    again."""
    entry, node = _entries(dut)[0], dut.strangers(0.2)[0]
    _watch(dut, entry, node)
    dut.forget()
    dut.frames("not heard yet", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)
    _beat(dut, node)
    dut.frames("heard once", dut.receive(2.5e-3 * _WATCHED_MS), dut.emergency_id, _LOST)
    dut.reset()
    dut.forget()
    dut.frames("after the reset", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)


# -- node guarding ---------------------------------------------------------------------------------------------


def guard(dut: DeviceUnderTest) -> list[Frame]:
    """A remote request, and what it brings."""
    dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
    return dut.receive_id(HEARTBEAT + dut.node_id, 0.1)


def guarding_answers(dut: DeviceUnderTest) -> None:
    """A remote frame brings the NMT state."""
    found = [received.data for received in guard(dut)]
    ok = len(found) == 1 and found[0][:1] in (b"\x7f", b"\xff")
    dut.check("remote request", "7f or ff", " ".join(data.hex() for data in found) or "nothing", ok)


def guarding_toggles(dut: DeviceUnderTest) -> None:
    """The top bit alternates."""
    found = [received.data[0] for _ in range(4) for received in guard(dut)]
    ok = len(found) == 4 and all(a ^ b == 0x80 for a, b in pairwise(found))
    dut.check("four remote requests", "bit 7 alternates", " ".join(f"{value:02x}" for value in found) or "nothing", ok)
