"""Actions of many cases: objects read, written and compared, frames that are expected, identifiers by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

from hilbench.apps.conformance.actions import ABORT_DIGITS, ACTIONS, AbortCode, Digits, Key
from hilbench.apps.conformance.dut import DeviceUnderTest, aborted, multiplexed
from hilbench.apps.conformance.record import NotApplicableError, some
from hilbench.apps.conformance.wire import periods, steady
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import EMERGENCY, HEARTBEAT, SDO_ANSWER, SDO_REQUEST, SYNC
from hilbench.canopen.object_store import NO_OBJECT

ACTIONS.update(
    objects=DeviceUnderTest.needs,
    writable=DeviceUnderTest.needs_to_write,
    storing=DeviceUnderTest.needs_store,
    motion=DeviceUnderTest.needs_motion,
    heartbeats=DeviceUnderTest.produce_heartbeats,
    nmt=DeviceUnderTest.nmt,
    reset=DeviceUnderTest.reset,
    forget=DeviceUnderTest.forget,
    shows=DeviceUnderTest.shows,
    segments=DeviceUnderTest.segments,
    send_sync=DeviceUnderTest.sync,
)


def not_applicable(dut: DeviceUnderTest, why: str) -> None:
    """No device has it any more."""
    raise NotApplicableError(why)


def unless_there(dut: DeviceUnderTest, key: Key, otherwise: str) -> None:
    """Raises NotApplicableError for a device with this object."""
    if dut.eds.has(*key):
        raise NotApplicableError(otherwise)


def if_writable(dut: DeviceUnderTest, keys: list[Key], otherwise: str) -> None:
    """Raises NotApplicableError when none of these objects can be written."""
    if not any(dut.eds.can_write(*key) for key in keys):
        raise NotApplicableError(otherwise)


# -- values ----------------------------------------------------------------------------------------------------


def write(dut: DeviceUnderTest, values: Mapping[Key, int]) -> None:
    """Write numbers to those of these objects that can be written."""
    for key, value in values.items():
        if dut.eds.can_write(*key):
            dut.write(*key, value)


def reads(dut: DeviceUnderTest, what: str, values: Mapping[Key, int]) -> None:
    """Expect numbers in those of these objects that can be written; `{index}` is 1017h in `what`, `{key}` 1017h:0."""
    _reads(dut, what, {key: value for key, value in values.items() if dut.eds.can_write(*key)})


def _reads(dut: DeviceUnderTest, what: str, values: Mapping[tuple[int, int], int]) -> None:
    for (index, sub), value in values.items():
        dut.reads(what.format(index=f"{index:04X}h", key=f"{index:04X}h:{sub}"), index, sub, value)


def remember(dut: DeviceUnderTest, keys: Sequence[Key]) -> None:
    """Values of those of these objects that can be written, for `as_remembered` and `as_default`."""
    dut.remembered = {key: dut.value(*key) for key in keys if dut.eds.can_write(*key)}


def remember_area(dut: DeviceUnderTest, first: Key, last: Key, otherwise: str) -> None:
    """Values of an area. Raises NotApplicableError for a device that has nothing in it to be read."""
    keys = some([entry.key for entry in dut.eds.entries(first[0], last[0]) if entry.readable], otherwise)
    dut.remembered = {key: dut.value(*key) for key in keys}


def as_remembered(dut: DeviceUnderTest, what: str) -> None:
    """Expect what was there before."""
    _reads(dut, what, dut.remembered)


def as_default(dut: DeviceUnderTest, what: str) -> None:
    """Expect the defaults of the file in what was remembered."""
    entries = {key: dut.eds.entry(*key).default for key in dut.remembered}
    _reads(dut, what, {key: int.from_bytes(data, "little") for key, data in entries.items() if data is not None})


def read(dut: DeviceUnderTest, key: Key, expected: Sequence[str]) -> None:
    """Read up to four bytes, and expect one of these answers; `{mux}` is the object in it, `{default}` its default,
    `{emergency}`, `{sdo_request}` and `{sdo_answer}` predefined identifiers."""
    index, sub = key
    default = dut.eds.entry(*key).default if dut.eds.has(*key) else None
    base = {"emergency": EMERGENCY, "sdo_request": SDO_REQUEST, "sdo_answer": SDO_ANSWER}
    names = {name: (cob_id + dut.node_id).to_bytes(4, "little").hex() for name, cob_id in base.items()}
    names |= {"mux": multiplexed(0, index, sub)[1:4].hex(), "default": "????????" if default is None else default.hex()}
    request = multiplexed(0x40, index, sub).hex()
    dut.ask(f"read {index:04X}h:{sub}", request, *(each.format(**names, **ABORT_DIGITS) for each in expected))


def read_if_there(dut: DeviceUnderTest, head: str, keys: Sequence[Key]) -> None:
    """Objects that the file has are there, the others are not."""
    for index, sub in keys:
        there = dut.eds.has(index, sub)
        read(dut, (index, sub), [f"{head} {{mux}} ????????" if there else aborted(index, sub, NO_OBJECT)])


def refuse(dut: DeviceUnderTest, what: str, key: Key, codes: list[AbortCode], data: Digits | None = None) -> None:
    """Expect that data, or else the value that is there, are refused with one of these abort codes."""
    dut.refuses(what, *key, dut.data_of(*key, dut.value(*key)) if data is None else data, *codes)


def refuse_each(dut: DeviceUnderTest, value: int, keys: list[Key], codes: list[AbortCode]) -> None:
    """Expect that a number is refused by all of these objects that can be written."""
    for index, sub in keys:
        if dut.eds.can_write(index, sub):
            dut.refuses(f"{value} to {index:04X}h", index, sub, dut.data_of(index, sub, value), *codes)


def ask(dut: DeviceUnderTest, what: str, request: str, expected: Sequence[str], key: Key | None = None) -> None:
    """A request, and one of the expected answers to it; in those `{NO_OBJECT}` is an abort code, `{mux}` the object."""
    names = dict(ABORT_DIGITS)
    if key is not None:
        dut.touched.add(key)
        names["mux"] = multiplexed(0, *key)[1:4].hex()
    dut.ask(what, request.format(**names), *(each.format(**names) for each in expected))


# -- frames ----------------------------------------------------------------------------------------------------

_Sender = Literal["pdo", "emergency", "heartbeat", "sync"]


def _id_of(dut: DeviceUnderTest, of: _Sender) -> int:
    if of == "pdo":
        return dut.pdo.cob_id
    return SYNC if of == "sync" else dut.emergency_id if of == "emergency" else HEARTBEAT + dut.node_id


def counts(
    dut: DeviceUnderTest,
    what: str,
    of: _Sender,
    within_s: float,
    between: tuple[int, int],
    expected: str,
    seen: str,
    period_s: float | None = None,
    data: Digits | None = None,
) -> None:
    """Expect so many frames in a time, so far apart on average, with these data; of `seen` `{count}`, `{periods}` and
    `{data}` are filled in."""
    found = dut.receive_id(_id_of(dut, of), within_s)
    ok = between[0] <= len(found) <= between[1] and (period_s is None or steady(found, period_s))
    ok = ok and all(data in (None, received.data) for received in found)
    several = ", ".join(sorted({received.data.hex() for received in found}))
    dut.check(what, expected, seen.format(count=len(found), periods=periods(found), data=several), ok)


def expect(dut: DeviceUnderTest, what: str, of: _Sender, within_s: float, frames: Sequence[str] = ()) -> None:
    """Expect these frames in a time, or none. `{any}`: any data of the PDO."""
    _expect(dut, what, dut.receive(within_s), of, frames)


def sync(dut: DeviceUnderTest, what: str, of: _Sender, frames: Sequence[str] = (), data: Digits = b"") -> None:
    """Expect that a SYNC brings these frames, or none."""
    _expect(dut, what, dut.sync(data), of, frames)


def _expect(dut: DeviceUnderTest, what: str, found: list[Frame], of: _Sender, frames: Sequence[str]) -> None:
    if of == "pdo":
        frames = [each.format(any="??" * dut.pdo.size) for each in frames]
    dut.frames(what, found, _id_of(dut, of), *frames)


def send_request(dut: DeviceUnderTest, data: Digits) -> None:
    """An SDO request that has no answer."""
    dut.send(SDO_REQUEST + dut.node_id, data)
