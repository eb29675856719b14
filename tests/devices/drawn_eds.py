"""Small EDS files in the habits of twelve makers, three drives each: drawn here, no maker's text is in them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

_I8, _I16, _I32, _U8, _U16, _U32 = 2, 3, 4, 5, 6, 7
_BOOLEAN, _TEXT, _TIME_OF_DAY, _DOMAIN = 1, 9, 0xC, 0xF


@dataclass(frozen=True)
class Entry:
    """A variable of a file."""

    data_type: int
    default: str = "0"
    access: str = "rw"
    mappable: bool = False
    more: str = ""  #: further lines


Entries = dict[tuple[int, int], Entry]

#: What all of them have.
_COMMON: Mapping[tuple[int, int], Entry] = {
    (0x1000, 0): Entry(_U32, "0x00020192", "ro"),
    (0x1001, 0): Entry(_U8, "0", "ro"),
    (0x1005, 0): Entry(_U32, "0x80"),
    (0x1014, 0): Entry(_U32, "$NODEID+0x80"),
    (0x1017, 0): Entry(_U16),
    (0x1018, 0): Entry(_U8, "1", "ro"),
    (0x1018, 1): Entry(_U32, "0x2FFFF", "ro"),
    (0x1400, 0): Entry(_U8, "2", "ro"),
    (0x1400, 1): Entry(_U32, "$NODEID+0x200"),
    (0x1400, 2): Entry(_U8, "255"),
    (0x1600, 0): Entry(_U8, "1"),
    (0x1600, 1): Entry(_U32, "0x60400010"),
    (0x1600, 2): Entry(_U32),
    (0x1800, 0): Entry(_U8, "2", "ro"),
    (0x1800, 1): Entry(_U32, "$NODEID+0x40000180"),
    (0x1800, 2): Entry(_U8, "255"),
    (0x1A00, 0): Entry(_U8, "1"),
    (0x1A00, 1): Entry(_U32, "0x60410010"),
    (0x1A00, 2): Entry(_U32),
    (0x6040, 0): Entry(_U16, mappable=True),
    (0x6041, 0): Entry(_U16, "", "ro", mappable=True),
    (0x6060, 0): Entry(_I8),
    (0x6061, 0): Entry(_I8, "0", "ro"),
    (0x6064, 0): Entry(_I32, "0", "ro", mappable=True),
    (0x606C, 0): Entry(_I32, "0", "ro", mappable=True),
    (0x6076, 0): Entry(_U32, "1000"),
    (0x6083, 0): Entry(_U32, "100000"),
    (0x6084, 0): Entry(_U32, "100000"),
    (0x608F, 0): Entry(_U8, "2", "ro"),
    (0x608F, 1): Entry(_U32, "4096"),
    (0x608F, 2): Entry(_U32, "1"),
    (0x60A9, 0): Entry(_U32, "0x00B44700"),
}
#: By drive: its mode of operation, the target that it moves by, and its objects.
DRIVES: Mapping[str, tuple[int, int, Mapping[tuple[int, int], Entry]]] = {
    "positioner": (
        1,
        0x607A,
        {
            (0x607A, 0): Entry(_I32, mappable=True),
            (0x6081, 0): Entry(_U32, "3000"),
            (0x6502, 0): Entry(_U32, "1", "ro"),
        },
    ),
    "inverter": (3, 0x60FF, {(0x60FF, 0): Entry(_I32, mappable=True), (0x6502, 0): Entry(_U32, "0x4", "ro")}),
    "servo": (
        9,
        0x60FF,
        {
            (0x60FF, 0): Entry(_I32, mappable=True),
            (0x60C2, 0): Entry(_U8, "2", "ro"),
            (0x60C2, 1): Entry(_U8, "10"),
            (0x60C2, 2): Entry(_I8, "-3"),
            (0x6502, 0): Entry(_U32, "0x380", "ro"),
        },
    ),
}


def _without(*indices: int) -> Callable[[Entries], None]:
    def change(entries: Entries) -> None:
        for key in [key for key in entries if key[0] in indices]:
            del entries[key]

    return change


def _with(changes: Entries) -> Callable[[Entries], None]:
    return lambda entries: entries.update(changes)


def _access(access: str, *keys: tuple[int, int]) -> Callable[[Entries], None]:
    def change(entries: Entries) -> None:
        for key in keys:
            old = entries[key]
            entries[key] = Entry(old.data_type, old.default, access, old.mappable, old.more)

    return change


def _more_pdos(cob_id: str, receive: str, transmit: str) -> Callable[[Entries], None]:
    """Two PDOs more, with these mapping entries."""
    return _with(
        {
            (0x1401, 0): Entry(_U8, "2", "ro"),
            (0x1401, 1): Entry(_U32, f"$NODEID+{cob_id}0300"),
            (0x1401, 2): Entry(_U8, "254"),
            (0x1601, 0): Entry(_U8, "1"),
            (0x1601, 1): Entry(_U32, receive),
            (0x1801, 0): Entry(_U8, "2", "ro"),
            (0x1801, 1): Entry(_U32, f"$NODEID+{cob_id}0280"),
            (0x1801, 2): Entry(_U8, "254"),
            (0x1A01, 0): Entry(_U8, "1"),
            (0x1A01, 1): Entry(_U32, transmit),
        }
    )


#: By habit: what its maker makes of the objects.
HABITS: Mapping[str, tuple[Callable[[Entries], None], ...]] = {
    "neither_sync_nor_heartbeat_objects": (_without(0x1005, 0x1017, 0x1014),),
    "guarding_in_place_of_heartbeat": (
        _without(0x1017),
        _with({(0x100C, 0): Entry(_U16, "100"), (0x100D, 0): Entry(_U8, "3")}),
    ),
    "empty_entries_that_count": (
        _with({(0x1600, 0): Entry(_U8, "2"), (0x1A00, 0): Entry(_U8, "2")}),
        _more_pdos("0x8000", "0", "0"),
    ),
    "maps_of_objects_that_are_not_there": (_more_pdos("0x8000", "0x20770010", "0x2F990020"),),
    "valid_pdos_with_such_maps": (_more_pdos("0x0000", "0x20770010", "0x60410020"),),
    "limits_beyond_their_type": (
        _with(
            {
                (0x2100, 0): Entry(_U16, "10", more="LowLimit=-1\nHighLimit=65536\n"),
                (0x2101, 0): Entry(_U8, "0", more="LowLimit=1\nHighLimit=5\n"),
            }
        ),
    ),
    "defaults_that_are_none": (
        _with({(0x2100, 0): Entry(_U8, "300"), (0x2101, 0): Entry(_U16, "see manual"), (0x6080, 0): Entry(_U32, "-1")}),
    ),
    "objects_of_the_profile_as_text": (_with({(0x6067, 0): Entry(_TEXT, "none"), (0x6098, 0): Entry(_DOMAIN)}),),
    "types_of_their_own_and_times": (
        _with(
            {
                (0x2100, 0): Entry(0x40, "3", mappable=True),
                (0x2101, 0): Entry(0x41, "whatever"),
                (0x2102, 0): Entry(_TIME_OF_DAY, "0", "ro", mappable=True),
                (0x2103, 0): Entry(0x0D, "", "ro"),
                (0x2104, 0): Entry(_DOMAIN, "see manual"),
                (0x2105, 0): Entry(_TEXT, "drive 5; rev. B", "const"),
            }
        ),
    ),
    "flags_of_one_bit": (
        _with({(0x2100, 0): Entry(_BOOLEAN, "1", "ro", mappable=True)}),
        _more_pdos("0x0000", "0x60400010", "0x21000001"),
    ),
    "read_only_cob_ids": (_access("ro", (0x1400, 1), (0x1800, 1)), _more_pdos("0x8000", "0x60400010", "0x60640020")),
    "units_by_feed_constant": (
        _without(0x608F, 0x60A9, 0x6076),
        _with(
            {
                (0x6091, 0): Entry(_U8, "2", "ro"),
                (0x6091, 1): Entry(_U32, "1"),
                (0x6091, 2): Entry(_U32, "1"),
                (0x6092, 0): Entry(_U8, "2", "ro"),
                (0x6092, 1): Entry(_U32, "36000"),
                (0x6092, 2): Entry(_U32, "1"),
            }
        ),
    ),
}
#: A maker's own types: one of 16 bits, and one that nobody defines.
_TYPES = "\n".join(
    f"[{index:04X}]\nParameterName=T_{index:X}\nObjectType=0x5\nDataType=0x7\nAccessType=ro\n{default}"
    for index, default in ((0x40, "DefaultValue=16\n"), (0x41, ""))
)


def eds_text(habit: str, drive: str) -> str:
    """The file of one drive by the maker of a habit."""
    entries: Entries = {**_COMMON, **DRIVES[drive][2]}
    for change in HABITS[habit]:
        change(entries)
    records = {index for index, sub in entries if sub}
    lines = ["; drawn for a test", "[FileInfo]", "FileName=", "[DeviceInfo]", f"ProductName={drive}"]
    if habit == "types_of_their_own_and_times":
        lines.append(_TYPES)
    for (index, sub), entry in sorted(entries.items()):
        if index in records and sub == 0:
            lines += [f"[{index:04x}]", f"ParameterName=Object {index:04X}", "ObjectType=0x9", "SubNumber=9"]
        name = f"{index:04x}sub{sub:x}" if index in records else f"{index:04X}"
        lines += [f"[{name}]", f"ParameterName=Entry {name}", f"DataType=0x{entry.data_type:04X}"]
        lines += [f"AccessType={entry.access}", f"DefaultValue={entry.default}", f"PDOMapping={int(entry.mappable)}"]
        lines += entry.more.splitlines()
    return "\r\n".join(lines) + "\r\n"
