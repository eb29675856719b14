"""Condition of a bench by the frames received: it runs, has ended, was stopped, or is silent."""

from __future__ import annotations

from enum import Enum

from hilbench.can.frame import Frame
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.canopen.identifiers import HEARTBEAT, NMT, SYNC, NmtCommand

_ALL = 0
#: With it a bench begins.
START_ALL = bytes((NmtCommand.START, _ALL))
#: NMT commands with which a bench lets its nodes go: stop, enter PRE-OPERATIONAL.
_LET_GO = (NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL)
#: Wall time without a SYNC, or without anything of a node, after which what it said is old.
SILENCE_S = 1.0


class Condition(Enum):
    """Condition of a bench in the words of the monitor."""

    NOT_RECEIVED = "not received"
    RUNNING = "running"
    STALE = "STALE"
    ENDED = "ENDED"
    EMERGENCY_STOP = "E-STOP"


class BenchWatch:
    """Follows the frames of one bus; times are s of the monotonic clock."""

    def __init__(self, master_id: int) -> None:
        self._heartbeat = HEARTBEAT + master_id
        self._sync_s: float | None = None
        self._master_s: float | None = None
        self._ended: Condition | None = None

    def take(self, frame: Frame, now_s: float) -> None:
        """Take a received frame."""
        if frame.can_id == SYNC:
            self._sync_s = now_s
            if self._ended is Condition.ENDED:
                self._ended = None  # another master released nodes: the bench goes on
        elif frame.can_id == EMERGENCY_STOP_COB_ID:
            self._ended = Condition.EMERGENCY_STOP
        elif frame.can_id == NMT and len(frame.data) == 2:
            self._command(frame.data[0], frame.data[1])
        elif frame.can_id == self._heartbeat:
            self._master_s = now_s

    def _command(self, command: int, node_id: int) -> None:
        if command == NmtCommand.START:
            self._ended = None
        elif command in _LET_GO and node_id == _ALL and self._ended is None and self._sync_s is not None:
            self._ended = Condition.ENDED

    def condition(self, now_s: float) -> Condition:
        """Present condition of the bench."""
        if self._ended is not None:
            return self._ended
        if self._sync_s is None:
            return Condition.NOT_RECEIVED
        return Condition.RUNNING if now_s - self._sync_s <= SILENCE_S else Condition.STALE

    def text(self, now_s: float) -> str:
        """The condition with what is known of it."""
        alive = self._master_s is not None and now_s - self._master_s <= SILENCE_S
        why = "the bench pauses" if alive else "nothing of the bench either"
        known = {
            Condition.EMERGENCY_STOP: ": an emergency stop was received, nodes are not started again yet",
            Condition.ENDED: ": the bench has let its nodes go",
            Condition.STALE: f": no SYNC for {now_s - (self._sync_s or 0.0):.0f} s, {why}",
            Condition.NOT_RECEIVED: ": no SYNC on this bus yet (a run --in-process is on none)",
        }
        condition = self.condition(now_s)
        return f"{condition.value}{known.get(condition, '')}"
