"""Heartbeat and node guarding (CiA 301, 7.2.8.3.2): producer, consumer, and both at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest, aborted
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.apps.conformance.wire import ReceivedFrame, periods, steady
from hilbench.can.frame import REMOTE_FLAG
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, NmtCommand, NmtState
from hilbench.canopen.object_store import INCOMPATIBLE, NO_OBJECT

LOST: Final = "30 81"
_PERIOD_MS: Final = 100
_WATCHED_MS: Final = 200
_PRE_OPERATIONAL: Final = NmtState.PRE_OPERATIONAL.heartbeat
_MOST_ENTRIES: Final = 4


def _produced(dut: DeviceUnderTest, duration_s: float) -> list[ReceivedFrame]:
    dut.forget()
    return dut.receive_id(HEARTBEAT + dut.node_id, duration_s)


def period_is_written(dut: DeviceUnderTest) -> None:
    """1017h keeps it."""
    dut.produce_heartbeats(_PERIOD_MS)
    dut.reads("read 1017h back", 0x1017, 0, _PERIOD_MS)


def count(dut: DeviceUnderTest) -> None:
    """20 in 2 s, one each 100 ms."""
    dut.produce_heartbeats(_PERIOD_MS)
    found = _produced(dut, 2.0)
    ok = 19 <= len(found) <= 21 and steady(found, _PERIOD_MS / 1000.0)
    ok = ok and all(received.data == _PRE_OPERATIONAL for received in found)
    seen = f"{len(found)}{periods(found)}, {', '.join(sorted({received.data.hex() for received in found}))}"
    dut.check("heartbeats of 100 ms", "20 in 2 s, 100 ms on average, 7f", seen, ok)


def disabled(dut: DeviceUnderTest) -> None:
    """1017h = 0."""
    dut.produce_heartbeats(_PERIOD_MS)
    dut.shows(NmtState.PRE_OPERATIONAL)
    dut.produce_heartbeats(0)
    dut.silent("1017h = 0", _produced(dut, 1.0), HEARTBEAT + dut.node_id)


# -- consumer --------------------------------------------------------------------------------------------------


def _entries(dut: DeviceUnderTest) -> list[int]:
    found = [entry.sub for entry in dut.eds.entries(0x1016, 0x1016) if entry.sub and entry.writable]
    if not found:
        raise NotApplicableError("1016h:1 is not in the EDS file, to be written")
    return found[:_MOST_ENTRIES]


def _strangers(dut: DeviceUnderTest) -> list[int]:
    """Node ids that were not received, and that no heartbeat consumer entry watches."""
    received = {each.can_id - HEARTBEAT for each in dut.receive(0.2)}
    watched = {dut.value(0x1016, sub) >> 16 & 0x7F for sub in _entries(dut)}
    return [node for node in range(LAST_NODE, 0, -1) if node not in received | watched | {dut.node_id}]


def _watch(dut: DeviceUnderTest, entry: int, node: int, time_ms: int = _WATCHED_MS) -> None:
    dut.write(0x1016, entry, node << 16 | time_ms)


def _beat(dut: DeviceUnderTest, node: int) -> None:
    dut.send(HEARTBEAT + node, _PRE_OPERATIONAL)


def watched_once(dut: DeviceUnderTest) -> None:
    """A node that one entry watches can't be watched by another."""
    first, *others = _entries(dut)
    if not others:
        raise NotApplicableError("1016h has one entry only")
    node = _strangers(dut)[0]
    _watch(dut, first, node)
    value = (node << 16 | _WATCHED_MS).to_bytes(4, "little")
    dut.refuses("the same node in another entry", 0x1016, others[0], value, INCOMPATIBLE)


def received_in_time(dut: DeviceUnderTest) -> None:
    """No EMCY while heartbeats come."""
    for entry, node in zip(_entries(dut), _strangers(dut), strict=False):
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


def missed(dut: DeviceUnderTest) -> None:
    """EMCY 8130h when they stay away."""
    for entry, node in zip(_entries(dut), _strangers(dut), strict=False):
        _watch(dut, entry, node)
        dut.forget()
        _beat(dut, node)
        found = dut.receive(2.5e-3 * _WATCHED_MS)
        dut.frames(f"entry {entry}: no heartbeat any more", found, dut.emergency_id, f"{LOST} ?? ??????????")
        dut.write(0x1016, entry, 0)
        dut.forget()


def reset_ends_watch(dut: DeviceUnderTest) -> None:
    """The consumer time begins with the first heartbeat; after a reset no node is missed that was not received
    again."""
    entry, node = _entries(dut)[0], _strangers(dut)[0]
    _watch(dut, entry, node)
    dut.forget()
    dut.silent("not heard yet", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)
    _beat(dut, node)
    dut.frames("heard once", dut.receive(2.5e-3 * _WATCHED_MS), dut.emergency_id, f"{LOST} ?? ??????????")
    dut.reset()
    dut.forget()
    dut.silent("after the reset", dut.receive(3e-3 * _WATCHED_MS), dut.emergency_id)


# -- node guarding ---------------------------------------------------------------------------------------------


def _needs_guarding(dut: DeviceUnderTest) -> None:
    dut.needs((0x100C, 0), (0x100D, 0))


def guarding_objects(dut: DeviceUnderTest) -> None:
    """Guard time and life time factor."""
    _needs_guarding(dut)
    dut.ask("read 100Ch:0", "40 0c 10 00 00000000", "4b 0c 10 00 ????????")
    dut.ask("read 100Dh:0", "40 0d 10 00 00000000", "4f 0d 10 00 ????????")


def _guard(dut: DeviceUnderTest) -> list[ReceivedFrame]:
    dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
    found = dut.receive_id(HEARTBEAT + dut.node_id, 0.1)
    return found


def _guarded(dut: DeviceUnderTest) -> None:
    _needs_guarding(dut)
    if dut.eds.can_write(0x1017):
        dut.write(0x1017, 0, 0)
    dut.forget()


def guarding_answers(dut: DeviceUnderTest) -> None:
    """A remote frame brings the NMT state."""
    _guarded(dut)
    found = [received.data for received in _guard(dut)]
    ok = len(found) == 1 and found[0][:1] in (b"\x7f", b"\xff")
    dut.check("remote request", "7f or ff", " ".join(data.hex() for data in found) or "nothing", ok)


def guarding_toggles(dut: DeviceUnderTest) -> None:
    """The top bit alternates."""
    _guarded(dut)
    found = [received.data[0] for _ in range(4) for received in _guard(dut)]
    ok = len(found) == 4 and all(a ^ b == 0x80 for a, b in pairwise(found))
    dut.check("four remote requests", "bit 7 alternates", " ".join(f"{value:02x}" for value in found) or "nothing", ok)


def guarding_times(dut: DeviceUnderTest) -> None:
    """They are kept."""
    dut.needs_to_write((0x100C, 0), (0x100D, 0))
    dut.write(0x100C, 0, 100)
    dut.write(0x100D, 0, 3)
    dut.reads("read 100Ch back", 0x100C, 0, 100)
    dut.reads("read 100Dh back", 0x100D, 0, 3)


def life_guarding(dut: DeviceUnderTest) -> None:
    """EMCY 8130h when no remote frame comes within guard time × factor."""
    guarding_times(dut)
    _guarded(dut)
    _guard(dut)
    dut.frames("no request any more", dut.receive(0.7), dut.emergency_id, f"{LOST} ?? ??????????")


def both(dut: DeviceUnderTest) -> None:
    """The objects that the file has are there, the others are not."""
    for index in (0x1017, 0x100C, 0x100D):
        request = f"40 {index & 0xFF:02x} 10 00 00000000"
        there = f"4? {index & 0xFF:02x} 10 00 ????????"
        expected = there if dut.eds.has(index) else aborted(index, 0, NO_OBJECT)
        dut.ask(f"read {index:04X}h:0", request, expected)


def switched_off(dut: DeviceUnderTest) -> None:
    """Nothing comes."""
    dut.produce_heartbeats(_PERIOD_MS)
    dut.produce_heartbeats(0)
    dut.silent("1017h = 0", _produced(dut, 1.0), HEARTBEAT + dut.node_id)


def guarding_alone(dut: DeviceUnderTest) -> None:
    """Guarding answers without a heartbeat."""
    guarding_answers(dut)


def heartbeat_alone(dut: DeviceUnderTest) -> None:
    """Four in 2 s at 500 ms, and one at once from a device whose period begins with a heartbeat."""
    dut.produce_heartbeats(500)
    _expect_beats(dut, "heartbeats of 500 ms", _produced(dut, 2.1))


def _expect_beats(dut: DeviceUnderTest, what: str, found: list[ReceivedFrame]) -> None:
    ok = len(found) in (4, 5) and steady(found, 0.5)
    dut.check(what, "4 or 5 heartbeats in 2.1 s", f"{len(found)}{periods(found)}", ok)


def not_disturbed(dut: DeviceUnderTest) -> None:
    """Remote requests bring nothing, and move no heartbeat."""
    if dut.eds.has(0x100C):
        raise NotApplicableError("the device has node guarding (100Ch)")
    _beats_beside_requests(dut)


def _beats_beside_requests(dut: DeviceUnderTest) -> None:
    dut.produce_heartbeats(500)
    dut.forget()
    found: list[ReceivedFrame] = []
    for _ in range(7):
        dut.send(REMOTE_FLAG | HEARTBEAT + dut.node_id, b"\0")
        found += dut.receive_id(HEARTBEAT + dut.node_id, 0.3)
    _expect_beats(dut, "requests every 300 ms", found)


def heartbeat_wins(dut: DeviceUnderTest) -> None:
    """With both set, the heartbeat is produced (CiA 301: it has priority)."""
    guarding_times(dut)
    heartbeat_alone(dut)


def heartbeat_beside_guarding(dut: DeviceUnderTest) -> None:
    """With both set, no remote request is answered."""
    guarding_times(dut)
    _beats_beside_requests(dut)


def _obsolete(dut: DeviceUnderTest) -> None:
    _needs_guarding(dut)
    raise NotApplicableError("100Eh (node guarding identifier) is obsolete: the identifier is 700h + node id")


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], None]]] = {
    "Guarding 1": guarding_objects,
    "Guarding 2": guarding_answers,
    "Guarding 3": guarding_toggles,
    "Guarding 4": _obsolete,
    "Guarding 5": guarding_times,
    "Guarding 6": life_guarding,
    "Heartbeat 1": period_is_written,
    "Heartbeat 2": count,
    "Heartbeat 3": disabled,
    "Heartbeat 4": watched_once,
    "Heartbeat 5": received_in_time,
    "Heartbeat 6": missed,
    "Heartbeat 7": reset_ends_watch,
    "Heartbeat and guarding 1": both,
    "Heartbeat and guarding 2": switched_off,
    "Heartbeat and guarding 3": guarding_alone,
    "Heartbeat and guarding 4": heartbeat_alone,
    "Heartbeat and guarding 5": not_disturbed,
    "Heartbeat and guarding 6": heartbeat_wins,
    "Heartbeat and guarding 7": heartbeat_beside_guarding,
}
