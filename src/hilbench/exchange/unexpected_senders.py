"""Foreign frames on the bench's bus, not of the bench or its nodes: a second sender or master, foreign SDO writes.

The bench does not receive what it sends itself on the cyclic path, and knows what it has sent for configuration. So
RPDOs, SYNC, its own heartbeat, NMT commands to its nodes, and SDO writes to them that it receives otherwise are not its
own. Surplus answers to SYNC are distinguished in `hilbench.exchange.answers`.

Reading by SDO does no harm, and writing to the bench's own node is how an operator asks for changes: neither is
reported.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import canopen
from hilbench.can.frame import Frame
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.canopen.identifiers import HEARTBEAT, NMT, SDO_ANSWER, SDO_REQUEST, SYNC, NmtCommand
from hilbench.exchange.answers import Tpdo

_DOWNLOAD, _ABORT, _BLOCK_DOWNLOAD = 1, 4, 6  # command specifiers of an SDO client
_COMMANDS: Mapping[int, str] = {
    NmtCommand.START: "start",
    NmtCommand.STOP: "stop",
    NmtCommand.ENTER_PRE_OPERATIONAL: "enter PRE-OPERATIONAL",
    NmtCommand.RESET_NODE: "reset node",
    NmtCommand.RESET_COMMUNICATION: "reset communication",
}
#: What was foreign: the node that it is of, or to, and the text.
_Finding = tuple[str, str]
#: Kinds of frames distinguished in a cycle on one identifier; any beyond count as the last.
_MOST_KINDS = 16
#: Up to so many surplus TPDOs of one sender within so many cycles may be a SYNC that was on the wire twice.
_BY_CHANCE, _CHANCE_CYCLES = 2, 500


@dataclass(frozen=True)
class Unexpected:
    """Frames of one kind in one cycle. `certain`: it can't be a whim of the wire."""

    about: str  #: the node that they are of, or to
    text: str
    count: int
    certain: bool


class UnexpectedSenders:
    """Detects foreign frames in each cycle.

    `nodes`: names by id, with their object dictionaries; `rpdos`: COB-IDs of the set points, and their receivers;
    `sent`: true once for each frame that the bench's configuration sent.
    """

    def __init__(
        self,
        master_id: int,
        nodes: Mapping[int, str],
        dictionaries: Mapping[int, canopen.ObjectDictionary],
        rpdos: Mapping[int, str],
        sent: Callable[[int, bytes], bool],
    ) -> None:
        self._nodes, self._dictionaries, self._sent = nodes, dictionaries, sent
        ours = {SYNC: "SYNC", HEARTBEAT + master_id: "heartbeat", SDO_ANSWER + master_id: "SDO answer"}
        self._read: dict[int, Callable[[int, bytes], _Finding | None]] = {
            NMT: self._nmt,
            **{can_id: self._only_ours("the bench", what) for can_id, what in ours.items()},
            **{can_id: self._only_ours(whom, "RPDO") for can_id, whom in rpdos.items()},
            **{SDO_REQUEST + node_id: self._sdo for node_id in nodes},
        }
        self._seen: dict[tuple[int, bytes], _Finding | None] = {}  # of this cycle: alike frames are looked at once
        self._kinds: dict[int, int] = {}
        self._last: dict[int, _Finding] = {}
        self._found: dict[_Finding, int] = {}
        self._cycle = 0
        self._surplus: dict[int, list[int]] = {}  # by COB-ID: the cycles of the last ones

    def look(self, frames: Iterable[Frame], tpdos: Iterable[Tpdo]) -> list[Unexpected]:
        """Foreign frames among those of a cycle; `tpdos` have classified their answers."""
        self._cycle += 1
        read = self._read
        for can_id, data, _ in frames:
            if can_id in read and not self._sent(can_id, data):
                self._look_at(can_id, data)
        found = [Unexpected(about, text, count, certain=True) for (about, text), count in self._found.items()]
        if self._seen:
            self._seen, self._kinds, self._last, self._found = {}, {}, {}, {}
        for tpdo in tpdos:
            if tpdo.surplus or tpdo.wrong_size:
                found += self._beside(tpdo)
        return found

    def pass_over(self, cycles: int) -> None:
        """Count `cycles` cycles run without foreign frames."""
        self._cycle += cycles

    def _look_at(self, can_id: int, data: bytes) -> None:
        """Count it; a flood of ever other content on one identifier is counted as the last that was distinguished."""
        key = can_id, data
        if key in self._seen:
            finding = self._seen[key]
        elif self._kinds.get(can_id, 0) < _MOST_KINDS:
            self._seen[key] = finding = self._read[can_id](can_id, data)
            if finding is not None:
                self._kinds[can_id] = self._kinds.get(can_id, 0) + 1
                self._last[can_id] = finding
        else:
            finding = self._last[can_id]
        if finding is not None:
            self._found[finding] = self._found.get(finding, 0) + 1

    def _beside(self, tpdo: Tpdo) -> Iterable[Unexpected]:
        where = f"TPDO (COB-ID {tpdo.cob_id:03X}h)"
        if tpdo.wrong_size:
            text = f"{where} of a length other than {tpdo.size} bytes: not used"
            yield Unexpected(tpdo.sender, text, tpdo.wrong_size, certain=self._is_no_chance(tpdo))
        if tpdo.surplus:
            text = f"{where} more often than SYNC asks for it: of two senders the first behind SYNC is used"
            yield Unexpected(tpdo.sender, text, tpdo.surplus, certain=self._is_no_chance(tpdo))

    def _is_no_chance(self, tpdo: Tpdo) -> bool:
        cycles = self._surplus.setdefault(tpdo.cob_id, [])
        cycles.append(self._cycle)
        del cycles[: -_BY_CHANCE - 1]
        return len(cycles) > _BY_CHANCE and cycles[0] > self._cycle - _CHANCE_CYCLES

    # -- by identifier ---------------------------------------------------------------------------------------

    @staticmethod
    def _only_ours(about: str, what: str) -> Callable[[int, bytes], _Finding | None]:
        return lambda can_id, data: (about, f"{what} (COB-ID {can_id:03X}h) that the bench has not sent")

    def _nmt(self, can_id: int, data: bytes) -> _Finding | None:
        if len(data) != 2:
            return None
        command, node_id = data
        if node_id != 0 and node_id not in self._nodes:
            return None
        name = _COMMANDS.get(command, f"command {command}")
        return "all nodes" if node_id == 0 else self._name(node_id), f"NMT '{name}' that the bench has not sent"

    def _sdo(self, can_id: int, data: bytes) -> _Finding | None:
        if len(data) != 8:
            return None
        specifier, node_id = data[0] >> 5, can_id - SDO_REQUEST
        if specifier == _DOWNLOAD or (specifier == _BLOCK_DOWNLOAD and not data[0] & 1):
            return self._name(node_id), f"SDO write by another station: {self._object(node_id, data)}"
        return (self._name(node_id), "SDO abort by another station") if specifier == _ABORT else None

    def _name(self, node_id: int) -> str:
        return f"{self._nodes[node_id]} (node {node_id})"

    def _object(self, node_id: int, data: bytes) -> str:
        """Object and, of an expedited download, value of a request that begins one (CiA 301, 7.2.4.3.3)."""
        index, sub = int.from_bytes(data[1:3], "little"), data[3]
        place = f"{index:04X}h sub {sub}"
        expedited = data[0] >> 5 == _DOWNLOAD and data[0] & 2
        content = data[4 : 8 - (data[0] >> 2 & 3 if data[0] & 1 else 0)] if expedited else b""
        variable = eds.known(self._dictionaries[node_id], index, sub)
        if variable is None:
            return f"{place} = {content.hex(' ')}" if content else place
        value = f" = {_value(variable.data_type or 0, content)}" if content else ""
        return f"{place} '{variable.name}'{value}"


def _value(kind: int, content: bytes) -> str:
    try:
        value = data_type(kind).decode(content)
    except ValueError:
        return content.hex(" ")
    return repr(value) if isinstance(value, str | bytes) else str(value)
