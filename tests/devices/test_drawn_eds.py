"""EDS files in the habits of twelve makers, three drives each: each through simulate, boot, map, enable and move."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.conformance.virtual_bus import VirtualBus
from tests.devices.drawn_eds import DRIVES, HABITS, eds_text

NODE = 5
REQUEST, ANSWER = 0x600 + NODE, 0x580 + NODE
INVALID = 0x80000000
#: What is said of a file, besides the units that it does not tell.
SAID = {
    "defaults_that_are_none": (
        "2100h:0 (DefaultValue '300', left out), 2101h:0 (DefaultValue 'see manual', left out), 60",
    ),
    "objects_of_the_profile_as_text": (
        "6067h:0 (data type 0009h, not as in CiA 402, left out), 6098h:0 (data type 000Fh",
    ),
    "types_of_their_own_and_times": ("2101h:0 (data type 0041h, which the file does not define, taken as bytes)",),
    "valid_pdos_with_such_maps": ("RPDO2 is not sent or received", "TPDO2 is not sent or received"),
}


class Driven:
    """The drive of a file on a bus in one thread, by SDO."""

    def __init__(self, eds: Path) -> None:
        self.bus = VirtualBus(eds, NODE)

    def _ask(self, request: bytes) -> bytes:
        self.bus.send(REQUEST, request)
        (answer,) = (received.data for received in self.bus.listen(0.01) if received.can_id == ANSWER)
        return answer

    def read(self, index: int, sub: int = 0) -> int:
        answer = self._ask(bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0)))
        assert answer[0] & 0xE3 == 0x43, answer.hex(" ")
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little", signed=index in (0x6064, 0x606C))

    def write(self, index: int, value: int, sub: int = 0) -> None:
        size = self.bus.device.cell(index, sub).width
        assert size is not None
        head = bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, sub))
        data = value.to_bytes(size, "little", signed=value < 0).ljust(4, b"\0")
        answer = self._ask(head + data)
        assert answer[0] == 0x60, f"{index:04X}h sub {sub}: {answer.hex(' ')}"

    def map(self, communication: int, *entries: int) -> None:
        """CiA 301's procedure; a COB-ID that is read-only stays as it is."""
        mapping, cob_id = communication + 0x200, self.read(communication, 1)
        writable = self.bus.device.cell(communication, 1).variable.writable
        if writable:
            self.write(communication, cob_id | INVALID, 1)
        self.write(mapping, 0)
        for sub, entry in enumerate(entries, 1):
            self.write(mapping, entry, sub)
        self.write(mapping, len(entries))
        self.write(communication, 1, 2)
        if writable:
            self.write(communication, cob_id & ~INVALID, 1)

    def sync(self) -> list[bytes]:
        """A SYNC 10 ms after the last one; what TPDO1 brings."""
        self.bus.send(0x80, b"")
        return [received.data for received in self.bus.listen(0.01) if received.can_id == 0x180 + NODE]


@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("habit", HABITS)
def test_a_drive_of_a_makers_file_boots_is_mapped_enabled_and_moves(tmp_path: Path, habit: str, drive: str) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_bytes(eds_text(habit, drive).encode("latin-1"))
    mode, target, _ = DRIVES[drive]
    driven = Driven(eds)
    said = [note for note in driven.bus.node.assumptions if "is absent" not in note]
    assert [part in note for part, note in zip(SAID.get(habit, ()), said, strict=True)].count(False) == 0, said
    assert driven.read(0x1000) == 0x20192
    driven.map(0x1400, 0x60400010, target << 16 | 0x20)
    driven.map(0x1800, 0x60410010, 0x60640020)
    driven.write(0x6060, mode)
    driven.bus.send(0, bytes((1, NODE)))
    for word in (0x06, 0x07, 0x0F):
        driven.bus.send(0x200 + NODE, word.to_bytes(2, "little") + bytes(4))
        driven.sync()
    ((status, position),) = [(data[0], int.from_bytes(data[2:], "little", signed=True)) for data in driven.sync()]
    assert status & 0x6F == 0x27, "OPERATION ENABLED"
    for number in range(60):
        word = 0x1F if drive == "positioner" and number else 0x0F
        driven.bus.send(0x200 + NODE, word.to_bytes(2, "little") + (1000).to_bytes(4, "little"))
        assert len(driven.sync()) == 1
    moved = driven.read(0x6064) - position
    if drive == "positioner":
        assert moved == pytest.approx(1000, abs=5)
    else:
        assert moved > 1000
    assert driven.read(0x1001) == 0
