"""A drive with every mode of operation, and its test bench: objects as by SDO, cycles of 2 ms, a stiff motor."""

from __future__ import annotations

import tempfile
from math import pi
from pathlib import Path

from tests.cia402.stand_in import CYCLE_S, DriveUnderTest

from hilbench.cia402.switches import Switches

INCREMENTS = 10_000  # a turn; velocities in rpm
TURN_RAD = 2.0 * pi

#: Name, type, default, access of the objects (index, sub-index) that a drive with all modes has.
_I8, _I16, _I32, _U8, _U16, _U32 = 2, 3, 4, 5, 6, 7
OBJECTS: dict[tuple[int, int], tuple[int, int | str]] = {
    (0x1000, 0): (_U32, 0x00020192), (0x1001, 0): (_U8, 0), (0x1005, 0): (_U32, 0x80),
    (0x1014, 0): (_U32, "$NODEID+0x80"), (0x1017, 0): (_U16, 0),
    (0x1018, 0): (_U8, 1), (0x1018, 1): (_U32, 0x2FFFF),
    (0x1400, 0): (_U8, 2), (0x1400, 1): (_U32, "$NODEID+0x200"), (0x1400, 2): (_U8, 1),
    (0x1600, 0): (_U8, 2), (0x1600, 1): (_U32, 0x60400010), (0x1600, 2): (_U32, 0x607A0020),
    (0x1800, 0): (_U8, 2), (0x1800, 1): (_U32, "$NODEID+0x180"), (0x1800, 2): (_U8, 1),
    (0x1A00, 0): (_U8, 2), (0x1A00, 1): (_U32, 0x60410010), (0x1A00, 2): (_U32, 0x60640020),
    (0x6040, 0): (_U16, 0), (0x6041, 0): (_U16, 0), (0x6042, 0): (_I16, 0), (0x6043, 0): (_I16, 0),
    (0x6044, 0): (_I16, 0), (0x6046, 0): (_U8, 2), (0x6046, 1): (_U32, 0), (0x6046, 2): (_U32, 3000),
    (0x6048, 0): (_U8, 2), (0x6048, 1): (_U32, 2000), (0x6048, 2): (_U16, 2),
    (0x6049, 0): (_U8, 2), (0x6049, 1): (_U32, 4000), (0x6049, 2): (_U16, 2),
    (0x6060, 0): (_I8, 0), (0x6061, 0): (_I8, 0), (0x6064, 0): (_I32, 0), (0x6065, 0): (_U32, 0xFFFFFFFF),
    (0x6067, 0): (_U32, 20), (0x6068, 0): (_U16, 10), (0x606C, 0): (_I32, 0), (0x6071, 0): (_I16, 0),
    (0x6076, 0): (_U32, 50_000), (0x6077, 0): (_I16, 0), (0x607A, 0): (_I32, 0), (0x607C, 0): (_I32, 500),
    (0x607D, 0): (_U8, 2), (0x607D, 1): (_I32, 0), (0x607D, 2): (_I32, 0), (0x6081, 0): (_U32, 600),
    (0x6082, 0): (_U32, 0),
    (0x6083, 0): (_U32, 6000), (0x6084, 0): (_U32, 3000), (0x6098, 0): (_I8, 35),
    (0x6099, 0): (_U8, 2), (0x6099, 1): (_U32, 600), (0x6099, 2): (_U32, 30), (0x609A, 0): (_U32, 60000),
    (0x608F, 0): (_U8, 2), (0x608F, 1): (_U32, INCREMENTS), (0x608F, 2): (_U32, 1),
    (0x60A9, 0): (_U32, 0x00B44700), (0x60B8, 0): (_U16, 0), (0x60B9, 0): (_U16, 0), (0x60BA, 0): (_I32, 0),
    (0x60BB, 0): (_I32, 0), (0x60BC, 0): (_I32, 0), (0x60BD, 0): (_I32, 0), (0x60C1, 0): (_U8, 1),
    (0x60C1, 1): (_I32, 0), (0x60C2, 0): (_U8, 2), (0x60C2, 1): (_U8, 2), (0x60C2, 2): (_I8, -3),
    (0x60FD, 0): (_U32, 0), (0x60FF, 0): (_I32, 0), (0x6502, 0): (_U32, 0x3EF),
}  # fmt: skip
_RECORDS = {index for index, sub in OBJECTS if sub}


def eds_text(*without: int) -> str:
    """The EDS file, without some objects."""
    lines = ["[DeviceInfo]", "ProductName=drive with every mode"]
    for (index, sub), (data_type, default) in sorted(OBJECTS.items()):
        if index in without:
            continue
        if index in _RECORDS and sub == 0:
            lines += [f"[{index:04X}]", f"ParameterName=object {index:04X}", "ObjectType=0x9", "SubNumber=3"]
        section = f"{index:04X}sub{sub}" if index in _RECORDS else f"{index:04X}"
        lines += [f"[{section}]", f"ParameterName=entry {section}", "ObjectType=0x7", f"DataType=0x{data_type:04X}"]
        lines += ["AccessType=rw", f"DefaultValue={default}", "PDOMapping=1"]
    return "\n".join(lines) + "\n"


def eds_file(folder: Path, *without: int) -> Path:
    """The same as a file."""
    path = folder / "every_mode.eds"
    path.write_text(eds_text(*without))
    return path


class EveryMode(DriveUnderTest):
    """The drive; a statement about it is made after some cycles."""

    def __init__(self, switches: Switches | None = None, *, without: tuple[int, ...] = ()) -> None:
        with tempfile.TemporaryDirectory() as folder:
            super().__init__(eds_file(Path(folder), *without), switches=switches)

    def seconds(self, duration_s: float) -> int:
        """So much later; the statusword."""
        self.cycle(round(duration_s / CYCLE_S))
        return self.read(0x6041)

    @property
    def turns(self) -> float:
        return self.port.position_rad / TURN_RAD

    def start_at(self, turns: float) -> None:
        """The motor stands there."""
        self.port.position_rad = turns * TURN_RAD
        self.cycle()
