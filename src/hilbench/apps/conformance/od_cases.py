"""Actions of OD cases: every object behaves as in the EDS file (CiA 301, 7.4; CiA 306)."""

from __future__ import annotations

import re
import subprocess
import sys
from typing import Final, Literal

from hilbench.apps.conformance.description import REFUSE_READ, REFUSE_WRITE, Entry
from hilbench.apps.conformance.dut import DeviceUnderTest, answer_text, taken_text
from hilbench.apps.conformance.record import NotApplicableError, some
from hilbench.canopen.eds import variable
from hilbench.canopen.object_store import (
    GENERAL_ERROR,
    INVALID_VALUE,
    NO_DATA,
    NO_SUB_INDEX,
    READ_ONLY,
    VALUE_TOO_HIGH,
    VALUE_TOO_LOW,
)
from hilbench.canopen.sdo_client import Refusal
from hilbench.cia402.axis import of_first_axis

_AREAS: Final = {"communication": (0x1000, 0x1FFF), "device": (0x2000, 0x9FFF)}
_Area = Literal["communication", "device"]
_VAR: Final = 7  #: object type VAR
#: They take a signature only: cases of their own. A program's control and download are no parameters.
_COMMANDS: Final = (0x1010, 0x1011, *range(0x1F50, 0x1F60))
_CONTROLWORD: Final = 0x6040
_MAKERS: Final = (0x2000, 0x5FFF)
_ERROR_HISTORY: Final = 0x1003
#: Values of the moment: they are no parameters that have a default.
_OF_THE_MOMENT: Final = (0x1001, 0x1002, 0x1003, 0x1010, 0x1011)
_WARNING: Final = re.compile(r"Warning: (.*)")
_BAD_DEFAULT: Final = re.compile(r"invalid DefaultValue in \[([0-9A-Fa-f]{4})(?:sub([0-9A-Fa-f]+))?\]: .*")
_NO_VALUE_NOW: Final = (NO_DATA, GENERAL_ERROR)


def eds_checker(dut: DeviceUnderTest) -> None:
    """An independent checker (dcf-tools) has nothing to say about the file."""
    try:
        import dcf  # noqa: F401 - whether it is there
    except ImportError:
        raise NotApplicableError("dcf-tools is not installed: pip install dcf-tools") from None
    command = [sys.executable, "-c", "from dcf.cli import main; main()", "-n", str(dut.node_id), str(dut.eds.path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    warnings = _WARNING.findall(done.stdout + done.stderr)
    meant = [warning for warning in warnings if _is_number_of_a_real(dut, warning)]
    dut.notes += [f"{warning}: it takes the digits for bits, the file has the number" for warning in meant]
    left = [warning for warning in warnings if warning not in meant]
    remark = "; ".join(left) or ("" if warnings else " ".join((done.stdout + done.stderr).split()))
    ok = not remark and (done.returncode == 0 or bool(meant))
    dut.check(f"dcfchk {dut.eds.path.name}", "nothing", remark or "nothing", ok)


def _is_number_of_a_real(dut: DeviceUnderTest, warning: str) -> bool:
    """True for a warning on a default of a REAL32 or REAL64 that most readers of EDS files take as the number it is."""
    found = _BAD_DEFAULT.fullmatch(warning)
    key = (int(found[1], 16), int(found[2] or "0", 16)) if found else None
    return key is not None and dut.eds.has(*key) and isinstance(dut.eds.entry(*key).variable.default, float)


def access(dut: DeviceUnderTest, area: _Area) -> None:
    """Reading gives data of the object's length; what is writable takes them back."""
    first, last = _AREAS[area]
    found = some(list(dut.eds.entries(first, last)), f"no object of {first:04X}h to {last:04X}h is in the EDS file")
    if area == "communication":
        _open_pdos(dut)
    for entry in found:
        if entry.readable and not entry.flags & REFUSE_READ:
            _access(dut, entry)
    _note_maker_objects(dut, found)


def _access(dut: DeviceUnderTest, entry: Entry) -> None:
    data = dut.peek(*entry.key)
    may_be_empty = (entry.index == _ERROR_HISTORY and entry.sub) or (entry.kind.width is None and not entry.default)
    if may_be_empty and isinstance(data, Refusal):
        dut.check(f"read {entry}", "data, or no data available", str(data), data.code in _NO_VALUE_NOW)
        return
    text = answer_text(data)
    width = entry.kind.width
    ok = isinstance(data, bytes) and (width is None or len(data) == width)
    if dut.check(f"read {entry}", "data" if width is None else f"{width} bytes", text, ok):
        assert isinstance(data, bytes)
        if _may_write_back(dut, entry, data):
            _write_back(dut, entry, data)


def _may_write_back(dut: DeviceUnderTest, entry: Entry, data: bytes) -> bool:
    if not entry.writable or entry.index in _COMMANDS or of_first_axis(entry.index) == _CONTROLWORD or not data:
        return False
    return dut.motion or not _MAKERS[0] <= entry.index <= _MAKERS[1]


def _note_maker_objects(dut: DeviceUnderTest, found: list[Entry]) -> None:
    makers = [entry for entry in found if _MAKERS[0] <= entry.index <= _MAKERS[1] and entry.writable]
    if makers and not dut.motion:
        dut.notes.append(
            f"{len(makers)} objects of the maker (2000h to 5FFFh) were read, not written: what that does only he knows "
            "(--allow-motion)"
        )


def _write_back(dut: DeviceUnderTest, entry: Entry, data: bytes) -> None:
    if entry.key == (_ERROR_HISTORY, 0):
        data = bytes(len(data))  # the one value that may be written (CiA 301, 7.5.2.4): it clears the history
    answer = dut.try_to_write(*entry.key, data)
    dut.check(f"write {entry} back", "taken", taken_text(answer), answer == b"")


def _open_pdos(dut: DeviceUnderTest) -> None:
    """Make all PDOs invalid and unmapped, so that every parameter of theirs may be written."""
    for base in (0x1400, 0x1800):
        for number in dut.eds.pdos(base):
            if dut.eds.can_write(base + number, 1):
                cob_id = dut.value(base + number, 1) | 0x80000000
                dut.try_to_write(base + number, 1, cob_id.to_bytes(4, "little"))
                if dut.eds.can_write(base + number + 0x200, 0):
                    dut.try_to_write(base + number + 0x200, 0, b"\0")


def defaults(dut: DeviceUnderTest, area: _Area) -> None:
    """Defaults after a reset; what a device stores (1010h) may be another value, and is reported."""
    dut.reset()
    for entry in dut.eds.entries(*_AREAS[area]):
        default = entry.default
        if default is None or not entry.readable or entry.index in _OF_THE_MOMENT or entry.flags & REFUSE_READ:
            continue
        if entry.access == "ro" and area == "device":
            continue  # an actual value
        data = dut.peek(*entry.key)
        seen = answer_text(data)
        stored = entry.writable and dut.eds.has(0x1010, 1) and isinstance(data, bytes)
        if data != default and stored:
            dut.notes.append(f"{entry}: {seen}, default {default.hex(' ')} (it can be stored)")
            continue
        dut.check(f"default of {entry}", default.hex(" "), seen, data == default)


def read_only(dut: DeviceUnderTest) -> None:
    """The value that it has already is refused."""
    found = [entry for entry in dut.eds.entries() if entry.constant]
    for entry in found:
        data = dut.peek(*entry.key)
        if not isinstance(data, bytes) or not data:
            data = bytes(entry.kind.width or 4)
        if len(data) <= 4:
            dut.refuses(f"write {entry}", entry.index, entry.sub, data, READ_ONLY)
        else:
            _refuses_long(dut, entry, data)


def _refuses_long(dut: DeviceUnderTest, entry: Entry, data: bytes) -> None:
    """Check that a long write is refused, at once or after the last segment."""
    answer = dut.try_to_write(*entry.key, data)
    ok = isinstance(answer, Refusal) and answer.code == READ_ONLY
    dut.check(f"write {entry}", f"abort {READ_ONLY:08X}h", taken_text(answer), ok)


def sub_index_255(dut: DeviceUnderTest) -> None:
    """Sub-index 255 is absent, or has object and data type of the file."""
    for index in sorted({entry.index for entry in dut.eds.entries()}):
        data = dut.peek(index, 0xFF)
        if isinstance(data, bytes):
            _check_structure(dut, index, int.from_bytes(data, "little"))
            continue
        seen = answer_text(data)
        ok = isinstance(data, Refusal) and data.code == NO_SUB_INDEX
        dut.check(f"read {index:04X}h:255", f"abort {NO_SUB_INDEX:08X}h, or the structure", seen, ok)


def _check_structure(dut: DeviceUnderTest, index: int, found: int) -> None:
    kinds = {"ODVariable": _VAR, "ODArray": 8, "ODRecord": 9}
    wanted = kinds[type(dut.eds.od[index]).__name__]
    code = int(variable(dut.eds.od, index, 0).data_type or 0) if wanted == _VAR else found >> 8
    ok = found & 0xFF == wanted and (wanted != _VAR or found >> 8 & 0xFF == code & 0xFF)
    dut.check(f"structure in {index:04X}h:255", f"object type {wanted}, data type {code:02X}h", f"{found:08X}h", ok)


def limits(dut: DeviceUnderTest) -> None:
    """A value beyond a limit of the file is refused."""
    examined = 0
    for entry in dut.eds.entries():
        if not entry.writable or not entry.kind.is_integer or not _may_write_back(dut, entry, b"\0"):
            continue
        for value, code in ((entry.beyond("min"), VALUE_TOO_LOW), (entry.beyond("max"), VALUE_TOO_HIGH)):
            if value is not None:
                examined += 1
                dut.refuses(f"{value} to {entry}", *entry.key, dut.data_of(*entry.key, value), code, INVALID_VALUE)
    if not examined:
        raise NotApplicableError("the EDS file has no limit that could be passed")


def write_back(dut: DeviceUnderTest) -> None:
    """A value that was read is accepted when written back."""
    found = [e for e in dut.eds.entries(*_AREAS["device"]) if e.writable and not e.flags & (REFUSE_WRITE | REFUSE_READ)]
    for entry in some(found, "no object from 2000h on can be written by the EDS file"):
        data = dut.peek(*entry.key)
        if not isinstance(data, bytes):
            dut.check(f"read {entry}", "data", answer_text(data), False)
        elif _may_write_back(dut, entry, data):
            _write_back(dut, entry, data)
    _note_maker_objects(dut, found)
