"""Everything as it was: the parameters of a device before an examination, and back to them after each case.

Objects of the communication profile come first, a PDO by the procedure of CiA 301 (invalid, nothing mapped, entries,
number, parameters, valid). Outputs and commands (process data) are no parameters: a drive is without power afterwards.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from hilbench.apps.conformance.description import Entry
from hilbench.apps.conformance.dut import DeviceUnderTest, answer_text
from hilbench.apps.conformance.process_data import RPDO, TPDO, at_rest
from hilbench.canopen.identifiers import INVALID, MAPPING, NmtCommand
from hilbench.canopen.object_store import PRESENT_STATE
from hilbench.canopen.sdo_client import Answer, Refusal
from hilbench.cia402.axis import of_first_axis

#: Commands, not parameters: they are not written back.
_COMMANDS: Final = (0x1003, 0x1010, 0x1011, *range(0x1F50, 0x1F60), 0x6040)
_SYNC_PERIOD, _SYNC_COUNTER = (0x1006, 0), (0x1019, 0)
_PDO_PARAMETERS: Final = (2, 3, 5, 6)

Values = dict[tuple[int, int], bytes]


def snapshot(dut: DeviceUnderTest) -> Values:
    """Every parameter that can be read and written."""
    return {entry.key: data for entry in _parameters(dut) if isinstance(data := dut.peek(*entry.key), bytes)}


def _parameters(dut: DeviceUnderTest) -> Iterable[Entry]:
    return (entry for entry in dut.eds.entries() if entry.writable and of_first_axis(entry.index) not in _COMMANDS)


@dataclass(frozen=True)
class Lost:
    """A parameter that is not what it was."""

    name: str
    was: str
    found: str


def restore(dut: DeviceUnderTest, values: Values) -> list[Lost]:
    """Write back what was touched (after a reset: all), in PRE-OPERATIONAL. Returns what could not be."""
    dut.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    for _ in dut.eds.each_axis():
        at_rest(dut)
    keys = set(values) if dut.was_reset else {key for key in dut.touched if key in values}
    differing = {key for key in keys if dut.peek(*key) != values[key]}
    for pdo in sorted({index for key in differing if (index := _pdo_of(key[0])) is not None}):
        _restore_pdo(dut, pdo, values)
    parameters = [key for key in differing if _pdo_of(key[0]) is None]
    if _SYNC_COUNTER in parameters and _SYNC_PERIOD in values:
        dut.try_to_write(*_SYNC_PERIOD, bytes(4))  # while it is not 0 the counter stays as it is
        parameters.append(_SYNC_PERIOD)
    if any(index == 0x1016 for index, _ in parameters):
        for key in [key for key in parameters if key[0] == 0x1016]:
            dut.try_to_write(*key, bytes(4))  # two entries never watch one node
    for key in sorted(set(parameters), key=lambda key: (key == _SYNC_PERIOD, key)):
        answer = dut.try_to_write(*key, values[key])
        if isinstance(answer, Refusal) and answer.code == PRESENT_STATE and key == (0x1014, 0):
            answer = _through_invalid(dut, key, values[key])
    lost = [
        Lost(str(dut.eds.entry(index, sub)), values[index, sub].hex(" "), answer_text(found))
        for index, sub in sorted(differing)
        if (found := dut.peek(index, sub)) != values[index, sub]
    ]
    dut.touched.clear()
    dut.was_reset = False
    return lost


def _through_invalid(dut: DeviceUnderTest, key: tuple[int, int], data: bytes) -> Answer:
    dut.try_to_write(*key, (dut.value(*key) | INVALID).to_bytes(4, "little"))
    return dut.try_to_write(*key, data)


def _pdo_of(index: int) -> int | None:
    """Index of the communication parameters of the PDO that an object belongs to."""
    for base in (RPDO, TPDO):
        if base <= index < base + 2 * MAPPING:
            return index - MAPPING if index >= base + MAPPING else index
    return None


def _restore_pdo(dut: DeviceUnderTest, index: int, values: Values) -> None:
    cob_id = values.get((index, 1))
    if cob_id is None:
        return
    invalid = (int.from_bytes(cob_id, "little") | INVALID).to_bytes(4, "little")
    dut.try_to_write(index, 1, (dut.value(index, 1) | INVALID).to_bytes(4, "little"))
    dut.try_to_write(index, 1, invalid)
    mapping = index + MAPPING
    count = values.get((mapping, 0))
    if count is not None:
        dut.try_to_write(mapping, 0, b"\0")
        for sub in sorted(sub for at, sub in values if at == mapping and sub):
            dut.try_to_write(mapping, sub, values[mapping, sub])
        dut.try_to_write(mapping, 0, count)
    for sub in _PDO_PARAMETERS:
        if (index, sub) in values:
            dut.try_to_write(index, sub, values[index, sub])
    dut.try_to_write(index, 1, cob_id)
