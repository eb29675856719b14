"""Actions of heartbeat and node guarding cases (CiA 301, 7.2.8.3.2): producer, consumer, and both at once."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.apps.conformance.wire import ReceivedFrame, periods, steady
from hilbench.can.frame import REMOTE_FLAG
from hilbench.canopen.identifiers import HEARTBEAT, NmtCommand, NmtState
from hilbench.canopen.object_store import INCOMPATIBLE

_LOST: Final = "30 81 ?? ??????????"
_WATCHED_MS: Final = 200
_PRE_OPERATIONAL: Final = NmtState.PRE_OPERATIONAL.heartbeat
_MOST_ENTRIES: Final = 4


@action
def twenty_heartbeats(dut: DeviceUnderTest) -> None:
    """20 in 2 s, one each 100 ms."""
    dut.forget()
    found = dut.receive_id(HEARTBEAT + dut.node_id, 2.0)
    ok = 19 <= len(found) <= 21 and steady(found, 0.1)
    ok = ok and all(received.data == _PRE_OPERATIONAL for received in found)
    seen = f"{len(found)}{periods(found)}, {', '.join(sorted({received.data.hex() for received in found}))}"
    dut.check("heartbeats of 100 ms", "20 in 2 s, 100 ms on average, 7f", seen, ok)


@action
def four_heartbeats(dut: DeviceUnderTest) -> None:
    """Four in 2 s at 500 ms, and one at once from a device whose period begins with a heartbeat."""
    dut.forget()
    _expect_beats(dut, "heartbeats of 500 ms", dut.receive_id(HEARTBEAT + dut.node_id, 2.1))


@action
def heartbeats_beside_requests(dut: DeviceUnderTest) -> None:
    """Remote requests bring nothing, and move no heartbeat."""
    dut.forget()
    found: list[ReceivedFrame] = []
    for _ in range(7):
        dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
        found += dut.receive_id(HEARTBEAT + dut.node_id, 0.3)
    _expect_beats(dut, "requests every 300 ms", found)


def _expect_beats(dut: DeviceUnderTest, what: str, found: list[ReceivedFrame]) -> None:
    ok = len(found) in (4, 5) and steady(found, 0.5)
    dut.check(what, "4 or 5 heartbeats in 2.1 s", f"{len(found)}{periods(found)}", ok)


# -- consumer --------------------------------------------------------------------------------------------------


def _entries(dut: DeviceUnderTest) -> list[int]:
    found = [entry.sub for entry in dut.eds.entries(0x1016, 0x1016) if entry.sub and entry.writable]
    if not found:
        raise NotApplicableError("1016h:1 is not in the EDS file, to be written")
    return found[:_MOST_ENTRIES]


def _watch(dut: DeviceUnderTest, entry: int, node: int, time_ms: int = _WATCHED_MS) -> None:
    dut.write(0x1016, entry, node << 16 | time_ms)


def _beat(dut: DeviceUnderTest, node: int) -> None:
    dut.send(HEARTBEAT + node, _PRE_OPERATIONAL)


@action
def watched_once(dut: DeviceUnderTest) -> None:
    """A node that one entry watches can't be watched by another."""
    first, *others = _entries(dut)
    if not others:
        raise NotApplicableError("1016h has one entry only")
    node = dut.strangers(0.2)[0]
    _watch(dut, first, node)
    value = (node << 16 | _WATCHED_MS).to_bytes(4, "little")
    dut.refuses("the same node in another entry", 0x1016, others[0], value, INCOMPATIBLE)


@action
def received_in_time(dut: DeviceUnderTest) -> None:
    """No EMCY while heartbeats come."""
    for entry, node in zip(_entries(dut), dut.strangers(0.2), strict=False):
        _watch(dut, entry, node)
        dut.nmt(NmtCommand.START)
        dut.forget()
        found: list[ReceivedFrame] = []
        for _ in range(5):
            _beat(dut, node)
            found += dut.receive(_WATCHED_MS * 0.6e-3)
        dut.silent(f"entry {entry}: heartbeats in time", found, dut.emergency_id)
        dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        dut.write(0x1016, entry, 0)
        dut.forget()


@action
def missed(dut: DeviceUnderTest) -> None:
    """EMCY 8130h when they stay away."""
    for entry, node in zip(_entries(dut), dut.strangers(0.2), strict=False):
        _watch(dut, entry, node)
        dut.forget()
        _beat(dut, node)
        found = dut.receive(2.5e-3 * _WATCHED_MS)
        dut.frames(f"entry {entry}: no heartbeat any more", found, dut.emergency_id, _LOST)
        dut.write(0x1016, entry, 0)
        dut.forget()


@action
def reset_ends_watch(dut: DeviceUnderTest) -> None:
    """The consumer time begins with the first heartbeat; after a reset no node is missed that was not received
    again."""
    entry, node = _entries(dut)[0], dut.strangers(0.2)[0]
    _watch(dut, entry, node)
    dut.forget()
    dut.silent("not heard yet", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)
    _beat(dut, node)
    dut.frames("heard once", dut.receive(2.5e-3 * _WATCHED_MS), dut.emergency_id, _LOST)
    dut.reset()
    dut.forget()
    dut.silent("after the reset", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)


# -- node guarding ---------------------------------------------------------------------------------------------


@action
def guard(dut: DeviceUnderTest) -> list[ReceivedFrame]:
    """A remote request, and what it brings."""
    dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
    return dut.receive_id(HEARTBEAT + dut.node_id, 0.1)


@action
def guarding_answers(dut: DeviceUnderTest) -> None:
    """A remote frame brings the NMT state."""
    found = [received.data for received in guard(dut)]
    ok = len(found) == 1 and found[0][:1] in (b"\x7f", b"\xff")
    dut.check("remote request", "7f or ff", " ".join(data.hex() for data in found) or "nothing", ok)


@action
def guarding_toggles(dut: DeviceUnderTest) -> None:
    """The top bit alternates."""
    found = [received.data[0] for _ in range(4) for received in guard(dut)]
    ok = len(found) == 4 and all(a ^ b == 0x80 for a, b in pairwise(found))
    dut.check("four remote requests", "bit 7 alternates", " ".join(f"{value:02x}" for value in found) or "nothing", ok)
