"""Actions of PDO cases (CiA 301, 7.2.2, 7.5.2.35 to 7.5.2.38): communication in every NMT state, and mapping.

A case uses one of the device's own PDOs, with an object in it that it can change without moving anything. The object of
a drive's TPDO is the statusword, which changes by transitions 2 and 7 (no power stage is on in READY TO SWITCH ON);
that of its RPDO is the controlword. Of other devices it is a parameter that may be mapped and written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Final, Literal

from hilbench.apps.conformance.actions import ABORT_CODES
from hilbench.apps.conformance.description import Entry, Pdo
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import NotApplicableError, some
from hilbench.apps.conformance.steps import read_if_there
from hilbench.can.frame import REMOTE_FLAG
from hilbench.canopen.data_types import data_type
from hilbench.canopen.identifiers import COB_ID, INVALID, MAPPING, NO_REMOTE_REQUEST, NmtCommand
from hilbench.canopen.object_store import (
    INVALID_VALUE,
    NO_SUB_INDEX,
    NOT_MAPPABLE,
    PDO_LENGTH,
    PRESENT_STATE,
    READ_ONLY,
    UNSUPPORTED_ACCESS,
    VALUE_TOO_HIGH,
    WRITE_ONLY,
)
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
    found = [e for e in dut.eds.entries(0x2000) if e.variable.pdo_mappable and e.access in access and e.kind.is_integer]
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


# -- cases ------------------------------------------------------------------------------------------------------

_NOT_NOW: Final = (UNSUPPORTED_ACCESS, ABORT_CODES["COUNT_NOT_ZERO"], PRESENT_STATE)
_NOT_THERE: Final = (NOT_MAPPABLE, READ_ONLY, WRITE_ONLY, UNSUPPORTED_ACCESS)
_INHIBIT_S: Final = 0.1
_QUIET_S, _SOON_S = 0.3, 0.05
_TOLERANCE_S: Final = 0.003
_LARGEST_PDO: Final = 64
_BASES: Final = {"receive": RPDO, "transmit": TPDO}
_Direction = Literal["receive", "transmit"]


def scan(dut: DeviceUnderTest, direction: _Direction) -> None:
    """PDOs of the file are there, and the next one is not."""
    base = _BASES[direction]
    numbers = dut.eds.pdos(base)
    absent = next(number for number in range(513) if number not in numbers)
    read_if_there(dut, "43", [(base + number, 1) for number in (*numbers, absent)])


# -- communication in an NMT state -----------------------------------------------------------------------------


def remote_request(dut: DeviceUnderTest, state: NmtCommand) -> None:
    """A remote frame brings the TPDO in OPERATIONAL alone."""
    pdo = transmit_pdo(dut)
    forbidden = bool(dut.value(pdo.index, 1) & NO_REMOTE_REQUEST)
    set_up(dut, 1, remote=True)
    dut.nmt(state)
    dut.forget()
    dut.send(REMOTE_FLAG | pdo.cob_id, bytes(pdo.size))
    found = [each for each in dut.receive(_SOON_S) if not each.can_id & REMOTE_FLAG]
    if forbidden and not found and state is NmtCommand.START:
        raise NotApplicableError(f"{pdo.index:04X}h:1 forbids remote requests; allowed by hand, none is answered")
    dut.frames("remote request", found, pdo.cob_id, *(["??" * pdo.size] if state is NmtCommand.START else []))


def sent_on_change(dut: DeviceUnderTest) -> None:
    """Sent on a change in OPERATIONAL, not without one, and not before the inhibit time is over."""
    pdo = dut.pdo
    dut.receive(_SOON_S)
    dut.frames("nothing changes", dut.receive(_QUIET_S), pdo.cob_id)
    change(dut)
    found = dut.receive_id(pdo.cob_id, _SOON_S)
    seen = "; ".join(f"{each.can_id & COB_ID:03X} {each.data.hex(' ')}" for each in found[:4]) or "nothing"
    dut.check("a change", f"{pdo.cob_id:03X} with the new value", seen, bool(found))
    if dut.eds.can_write(pdo.index, 3):
        _inhibit_time(dut)
    else:
        dut.notes.append(f"no inhibit time ({pdo.index:04X}h:3) in the EDS file")


def _inhibit_time(dut: DeviceUnderTest) -> None:
    pdo = dut.pdo
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    set_up(dut, 254, inhibit=round(_INHIBIT_S * 10_000))
    dut.nmt(NmtCommand.START)
    dut.receive(2.0 * _INHIBIT_S)
    change(dut)
    found = dut.receive_id(pdo.cob_id, 0.1 * _INHIBIT_S)
    change(dut)
    found += dut.receive_id(pdo.cob_id, 3.0 * _INHIBIT_S)
    gaps = [(later.time_ns - earlier.time_ns) * 1e-9 for earlier, later in pairwise(found)]
    seen = ", ".join(f"{1000.0 * gap:.1f} ms" for gap in gaps) or f"{len(found)} frames"
    ok = bool(gaps) and min(gaps) >= _INHIBIT_S - _TOLERANCE_S
    dut.check("changes within the inhibit time", f"{1000.0 * _INHIBIT_S:g} ms between frames at least", seen, ok)


def every_third_sync(dut: DeviceUnderTest, state: NmtCommand) -> None:
    """Every third SYNC, whichever the device counts from: CiA 301 leaves that open without a SYNC counter."""
    transmit_pdo(dut)
    set_up(dut, 3)
    dut.nmt(state)
    came = [dut.sync_brings(dut.pdo.cob_id) for _ in range(6)]
    first = came.index(True) if any(came[:3]) else 2
    wanted = [number % 3 == first for number in range(6)] if state is NmtCommand.START else [False] * 6
    dut.check("six SYNCs, type 3", _marks(wanted), _marks(came), came == wanted)


def start_value(dut: DeviceUnderTest, state: NmtCommand) -> None:
    """SYNC start value with the SYNC counter: every second one from 4 on.

    4 counts as the first that is received; whether the first or the second of each two is answered is not decided.
    """
    pdo = transmit_pdo(dut)
    dut.needs_to_write([(0x1019, 0)])
    if dut.eds.can_write(0x1006) and dut.value(0x1006):
        dut.write(0x1006, 0, 0)
    dut.write(0x1019, 0, 10)
    set_up(dut, 2, start=4)
    dut.nmt(state)
    came = [counter for counter in range(1, 11) if dut.sync_brings(pdo.cob_id, bytes((counter,)))]
    wanted = ([4, 6, 8, 10], [5, 7, 9]) if state is NmtCommand.START else ([],)
    expected = f"{pdo.cob_id:03X} with {' or '.join(str(each or 'none') for each in wanted)}"
    dut.check("SYNC 1 to 10", expected, f"with {came or 'none'}", came in wanted)


def _marks(came: list[bool]) -> str:
    return " ".join("sent" if each else "-" for each in came)


# -- mapping ---------------------------------------------------------------------------------------------------


def default_mapping(dut: DeviceUnderTest) -> None:
    """Mapped objects are in the file, as long as the mapping states."""
    indices = [base + number for base in (RPDO, TPDO) for number in dut.eds.pdos(base)]
    for index in some(indices, "no PDO is in the EDS file"):
        for entry in mapped(dut, index):
            found, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
            text = f"{found:04X}h:{sub} of {bits} bits"
            if found < 0x1000:
                dut.check(f"{index + MAPPING:04X}h maps", "an object or a placeholder", text, True)
                continue
            known = dut.eds.entry(found, sub) if dut.eds.has(found, sub) else None
            ok = known is not None and known.mapping & 0xFF == bits
            dut.check(f"{index + MAPPING:04X}h maps {text}", "an object of that length in the EDS file", str(known), ok)


def _variable(dut: DeviceUnderTest, base: int) -> int:
    """Index of a PDO whose mapping can be written."""
    indices = [
        base + number
        for number in dut.eds.pdos(base)
        if dut.eds.can_write(base + number, 1) and dut.eds.can_write(base + number + MAPPING, 0)
    ]
    return some(indices, f"a mapping ({base + MAPPING:04X}h …) that can be written is not in the EDS file")[0]


def _opened(dut: DeviceUnderTest, base: int) -> int:
    """PDO made invalid, with nothing mapped."""
    index = _variable(dut, base)
    remote = NO_REMOTE_REQUEST if base == TPDO else 0
    cob_id = dut.value(index, 1) & COB_ID or (0x180 if base == TPDO else 0x200) + dut.node_id
    dut.write(index, 1, INVALID | remote | cob_id)
    dut.write(index + MAPPING, 0, 0)
    return index


def mapping_procedure(dut: DeviceUnderTest) -> None:
    """An RPDO that is mapped anew acts on the object that it then carries."""
    receive_pdo(dut)
    _variable(dut, RPDO)
    set_up(dut, 1)
    dut.nmt(NmtCommand.START)
    _acts(dut, "what the RPDO carried")


def _acts(dut: DeviceUnderTest, what: str, placeholder: bytes = b"") -> None:
    """Expect that the RPDO brings its object another value."""
    carries = dut.pdo.carries
    value = 0x06 if dut.eds.is_drive else dut.value(*carries.key) ^ 1
    dut.touched.add(carries.key)
    dut.send(dut.pdo.cob_id, placeholder + value.to_bytes(dut.pdo.size, "little"))
    dut.sync()
    dut.reads(f"{carries} has {what}", *carries.key, value)


def _of_each(dut: DeviceUnderTest, prepare: Callable[[DeviceUnderTest, int], int], otherwise: str = "") -> list[int]:
    """An RPDO and a TPDO, or that of the two which the device can have. Raises NotApplicableError for neither."""
    found = []
    for base in (RPDO, TPDO):
        try:
            found.append(prepare(dut, base))
        except NotApplicableError as error:
            dut.notes.append(str(error))
    return some(found, otherwise or (dut.notes or [""])[-1])


def _with_one_object(dut: DeviceUnderTest, base: int) -> int:
    carried = _carried(dut, base)[0]
    index = _opened(dut, base)
    map_objects(dut, index, [carried.mapping])
    return index


def _carried(dut: DeviceUnderTest, base: int) -> list[Entry]:
    """Objects that a PDO may carry. Raises NotApplicableError for a device that has nothing of the kind."""
    allowed = ("rw", "rww", "wo") if base == RPDO else ("rw", "rwr", "ro")
    mappable = (entry for entry in dut.eds.entries(0x2000) if entry.variable.pdo_mappable and entry.mapping & 0xFF)
    found = [entry for entry in mappable if entry.access in allowed]
    what = "an RPDO" if base == RPDO else "a TPDO"
    return some(found, f"no object from 2000h on may be mapped to {what} by the EDS file")


def mapping_without_procedure(dut: DeviceUnderTest) -> None:
    """An entry can't be written while the number of entries is not 0."""
    for index in _of_each(dut, _with_one_object):
        entry = dut.value(index + MAPPING, 1)
        dut.refuses("an entry, the number being 1", index + MAPPING, 1, entry.to_bytes(4, "little"), *_NOT_NOW)


def mapping_of_valid_pdo(dut: DeviceUnderTest) -> None:
    """Nor anything while the PDO is valid."""
    for index in _of_each(dut, _with_one_object):
        dut.write(index, 1, dut.value(index, 1) & ~INVALID)
        dut.refuses("the number of entries of a valid PDO", index + MAPPING, 0, b"\0", *_NOT_NOW)
        entry = dut.value(index + MAPPING, 1)
        dut.refuses("an entry of a valid PDO", index + MAPPING, 1, entry.to_bytes(4, "little"), *_NOT_NOW)


def too_many_objects(dut: DeviceUnderTest) -> None:
    """One more than the device has places for."""
    codes = (PDO_LENGTH, NOT_MAPPABLE, INVALID_VALUE, VALUE_TOO_HIGH)
    for index in _of_each(dut, _opened, "no mapping can be written by the EDS file"):
        places = max(entry.sub for entry in dut.eds.entries(index + MAPPING, index + MAPPING))
        dut.refuses(f"{places + 1} entries", index + MAPPING, 0, bytes((places + 1,)), *codes)
        if places < _LARGEST_PDO:
            dut.refuses("an entry more", index + MAPPING, places + 1, bytes(4), NO_SUB_INDEX)


def objects_too_long(dut: DeviceUnderTest) -> None:
    """More than eight bytes."""
    examined = 0
    for index in _of_each(dut, _opened, "no mapping can be written by the EDS file"):
        base = TPDO if index >= TPDO else RPDO
        try:
            longest = max(_carried(dut, base), key=lambda e: e.mapping & 0xFF)
        except NotApplicableError as error:
            dut.notes.append(str(error))
            continue
        needed = _LARGEST_PDO // (longest.mapping & 0xFF) + 1
        places = max(entry.sub for entry in dut.eds.entries(index + MAPPING, index + MAPPING))
        if places < needed:
            dut.notes.append(f"{index + MAPPING:04X}h: {places} places are not enough for more than eight bytes")
            continue
        examined += 1
        dut.touched.update((index + MAPPING, sub) for sub in range(needed + 1))
        for sub in range(1, needed):
            dut.write(index + MAPPING, sub, longest.mapping)
        refused = dut.try_to_write(index + MAPPING, needed, longest.mapping.to_bytes(4, "little"))
        if refused == b"":
            dut.refuses(f"{needed} × {longest}", index + MAPPING, 0, bytes((needed,)), PDO_LENGTH)
        else:
            dut.check(
                f"{needed} × {longest}", "refused", str(refused), str(refused).startswith(f"abort {PDO_LENGTH:08X}h")
            )
    if not examined:
        raise NotApplicableError(dut.notes[-1])


def maps(dut: DeviceUnderTest, direction: _Direction, kinds: list[str], mappable: bool, taken: bool) -> None:
    """Write an entry of objects of an access type; whether it is taken."""
    found = [e for e in dut.eds.entries(0x1000) if e.access in kinds and bool(e.variable.pdo_mappable) is mappable]
    may = "may" if mappable else "may not"
    why_not = f"no object of access type {' or '.join(kinds)} {may} be mapped by the EDS file"
    found = some([entry for entry in found if entry.mapping & 0xFF], why_not)
    index = _opened(dut, _BASES[direction])
    entry = max(found, key=lambda each: each.index >= 0x6000)  # the device's profile before its maker's
    data = entry.mapping.to_bytes(4, "little")
    if taken:
        dut.takes(f"map {entry}", index + MAPPING, 1, entry.mapping)
    else:
        dut.refuses(f"map {entry}", index + MAPPING, 1, data, *_NOT_THERE)


def placeholder(dut: DeviceUnderTest) -> None:
    """A dummy takes its place in the frame, and the object after it what follows."""
    dummy = max(some(dut.eds.dummies, "a placeholder ([DummyUsage]) is not in the EDS file"))
    bits = data_type(dummy).pdo_bits or 0
    pdo = receive_pdo(dut)
    opened = _opened(dut, RPDO)
    map_objects(dut, opened, [dummy << 16 | bits, pdo.carries.mapping])
    dut.configure(opened, 2, 1, "transmission type 1")
    dut.write(opened, 1, pdo.cob_id)
    dut.nmt(NmtCommand.START)
    _acts(dut, "what followed the placeholder", b"\xff" * (bits // 8))
