"""EMCY messages of the nodes as readable text."""

from __future__ import annotations

from dataclasses import dataclass
from struct import unpack_from

from hilbench.canopen.bus_cycle import OTHER_CYCLE
from hilbench.estimation.problems import TORQUE_SHIFT, UNDECIDED, Problem

#: Error codes and their classes (CiA 301, table 26), by the first digits that decide.
_CLASSES = {
    "10": "generic error",
    "2": "current",
    "3": "voltage",
    "4": "temperature",
    "5": "device hardware",
    "6": "device software",
    "7": "additional modules",
    "80": "monitoring",
    "8120": "CAN in error passive mode",
    "81": "communication",
    "82": "protocol error",
    "84": "velocity control",
    "86": "positioning",
    "90": "external error",
    "F0": "additional functions",
    "FF": "device specific",
}
_OF_TWIN = {int(problem): problem.name.lower().replace("_", " ") for problem in Problem} | {
    TORQUE_SHIFT: "shift of friction or torque offset of axis {axis}",
    OTHER_CYCLE: "SYNC comes by another cycle than the twin's config has",
    UNDECIDED: "ambiguous torque change on axis {axis} (E, friction or offset); another tension would decide",
}
#: Codes that the bench acts on: these are never too many.
ACTED_ON = frozenset({int(Problem.WEB_BREAK), int(Problem.SLIP)})
#: Distinct messages kept in one cycle; any beyond count as the last of their node.
MOST_IN_A_CYCLE = 32
_LENGTH = 8


@dataclass(frozen=True)
class Emergency:
    """One EMCY message; `code` 0 takes the code in `cleared` back."""

    node_id: int
    node: str
    code: int
    register: int
    cleared: int = 0
    size: float = 0.0  #: of TORQUE_SHIFT: what the measured torque has shifted by, N·m; of OTHER_CYCLE: the cycle, s
    part: int = 0  #: number of the span that the twin speaks of, on a line of several

    @classmethod
    def of(cls, node_id: int, node: str, data: bytes) -> Emergency | None:
        """Decode the data of an EMCY frame; None if they are no EMCY message."""
        if len(data) != _LENGTH:
            return None
        code = int.from_bytes(data[:2], "little")
        cleared = int.from_bytes(data[3:5], "little") if code == 0 else 0
        size = float(unpack_from("<f", data, 3)[0]) if code in (TORQUE_SHIFT, OTHER_CYCLE) else 0.0
        return cls(node_id, node, code, data[2], cleared, size, data[7] if code in _OF_TWIN else 0)

    @property
    def kind(self) -> str:
        """Key by which messages count as the same: the error code, or the code that is cleared; for each span apart."""
        return f"{self.code:04X}{self.cleared:04X}" + (f" {self.part}" if self.part else "")

    @property
    def where(self) -> str:
        """The span, for a message; "" where there is one."""
        return f" in span {self.part}" if self.part else ""

    def __str__(self) -> str:
        if self.code == 0:
            return f"EMCY cleared: {_meaning(self.cleared)}" if self.cleared else "EMCY 0000h: no error any more"
        if self.code == OTHER_CYCLE:
            return f"EMCY {self.code:04X}h: {_meaning(self.code)}: {1e3 * self.size:.4g} ms"
        size = f", {self.size:+.3g} N·m" if self.code == TORQUE_SHIFT else ""
        if self.code in (TORQUE_SHIFT, UNDECIDED):
            return f"EMCY {self.code:04X}h: {_meaning(self.code, self.part)}{size}"
        return f"EMCY {self.code:04X}h: {_meaning(self.code)}{self.where}"


class EmergencyInbox:
    """The EMCY messages of one cycle. A flood is counted, not decoded: alike frames once, and of others a few."""

    def __init__(self) -> None:
        self.messages: dict[Emergency, int] = {}  #: in their order, and how many of each
        self._seen: dict[tuple[int, bytes], Emergency] = {}
        self._last: dict[int, Emergency] = {}

    def clear(self) -> None:
        """Clear the messages at the begin of a cycle."""
        if self.messages:
            self.messages, self._seen, self._last = {}, {}, {}

    def add(self, node_id: int, node: str, data: bytes) -> bool:
        """Add a frame's data; False for what is no EMCY message."""
        emergency = self._seen.get((node_id, data))
        if emergency is None and len(data) == _LENGTH and len(self._seen) >= MOST_IN_A_CYCLE:
            known = self._last.get(node_id)
            emergency = None if int.from_bytes(data[:2], "little") in ACTED_ON else known
        if emergency is None:
            emergency = Emergency.of(node_id, node, data)
            if emergency is None:
                return False
            self._seen[node_id, data] = self._last[node_id] = emergency
        self.messages[emergency] = self.messages.get(emergency, 0) + 1
        return True


def _meaning(code: int, part: int = 0) -> str:
    """`part`: span at which it is; its torque is that of the axis behind it."""
    if code in _OF_TWIN:
        return _OF_TWIN[code].format(axis=part + 1 if part else 2)
    text = f"{code:04X}"
    return next((name for start, name in _CLASSES.items() if text.startswith(start)), "error")
