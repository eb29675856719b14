"""Classification of the TPDOs that answer SYNC: the answer to this SYNC, late ones to earlier SYNCs, and surplus.

A synchronous TPDO is sent once a SYNC. So it is known how many answers each sender still owes: a frame beyond
that is not the sender's own, or was on the wire twice. The answer used is the first frame after SYNC, once
the late ones still owed are taken off; one that came before SYNC is used only where none came after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

#: Cycles of one answer each after which an answer that is still owed counts as lost.
_LOST_CYCLES = 500
#: Answers that can be owed: a sender that owes more is as good as silent.
_MOST_OWED = 100
#: Number of SYNCs answered one by one after which a sender that is back has caught up.
_ONE_BY_ONE = 50


@dataclass(slots=True, eq=False)
class Tpdo:
    """A TPDO that the bench reads, and what has come of it.

    `every`: SYNCs between two of them; `supervised`: false while its sender works off what it has missed.
    """

    cob_id: int
    size: int
    every: int
    sender: str
    supervised: bool = True
    data: bytes | None = None  #: what is used in this cycle
    age_cycles: int = 0  #: of the data last used: 0 where this SYNC was answered in time
    surplus: int = 0  #: frames of this cycle that were not owed, except one that repeats the data used
    wrong_size: int = 0  #: frames of this cycle
    _owed: int = 0  # answers; cycles where they come every few SYNCs
    _steady: int = 0
    since: int = 1 << 30  # cycles since the last that was used
    _used: bytes = b""
    _is_back: bool = False
    _before: list[bytes] = field(default_factory=list)
    _behind: list[bytes] = field(default_factory=list)

    def begin(self) -> None:
        """A SYNC was sent."""
        self.data = None
        self.surplus = self.wrong_size = 0
        self._before.clear()
        self._behind.clear()

    def add(self, data: bytes, *, before_sync: bool) -> None:
        """A frame with its COB-ID."""
        if len(data) != self.size:
            self.wrong_size += 1
        elif before_sync:
            self._before.append(data)
        else:
            self._behind.append(data)

    @property
    def fits_fast_path(self) -> bool:
        """True if exactly one answer is to be expected to each SYNC that asks for it."""
        return self.is_regular and not self._owed

    @property
    def is_regular(self) -> bool:
        """True if answers arrive as usual: as `fits_fast_path`, but answers to each SYNC that are still owed after
        the last one are allowed: as a rule they are lost."""
        return self.supervised and not self.age_cycles and (self.every == 1 or not self._owed)

    def answered_until(self, cycles: int, data: bytes | None, since: int) -> None:
        """Account for `cycles` run by the fast path. `data`: the answer used last (None: none since), `since` cycles
        ago."""
        self.begin()
        self._pass_steadily(cycles)
        if data is not None:
            self._used = data
        if self.every == 1:
            self.since += cycles
        else:
            self.since = since if data is not None else self.since + cycles

    def _pass_steadily(self, cycles: int) -> None:
        """Count `cycles` cycles of one answer each."""
        while self._owed and self._steady + cycles >= _LOST_CYCLES:
            cycles -= _LOST_CYCLES - self._steady
            self._owed, self._steady = self._owed - 1, 0
        self._steady = self._steady + cycles if self._owed else 0

    def supervise(self, supervised: bool) -> None:
        """Stop or resume supervision of the sender: nothing is owed from before; it may catch up on missed SYNCs."""
        self.supervised, self._is_back = False, supervised
        self._owed = self._steady = 0

    def end(self, other_syncs: int) -> None:
        """Evaluate the complete frames of the cycle; `other_syncs` were on the bus in addition to the cycle's own."""
        self.since += 1 + other_syncs
        if not self.supervised:
            taken = self._before + self._behind
            self._use(taken[-1] if taken else None, in_time=bool(self._behind))
            self._steady = self._steady + 1 if len(taken) <= 1 else 0
            if self._is_back and self._steady >= _ONE_BY_ONE:
                self.supervised, self._steady = True, 0
        elif self.every == 1:
            self._end_of_each(other_syncs)
        else:
            self._end_of_some()

    def _end_of_each(self, other_syncs: int) -> None:
        before, behind = self._before, self._behind
        owed = self._owed + other_syncs
        if not owed and not before and len(behind) == 1:  # as a rule
            self._use(behind[0], in_time=True)
            self._steady = 0
            return
        late = min(owed, len(before))
        owed -= late
        used_before = self._used
        if behind:
            at = min(owed, len(behind) - 1)
            self._use(behind[at], in_time=True)
            owed -= at
        else:
            at = -1
            self._use(before[late - 1] if late else None, in_time=False)
            owed += 1
        self.surplus = _others(before[late:], used_before) + _others(behind[at + 1 :], self._used)
        self._steady = self._steady + 1 if owed and len(before) + len(behind) == 1 else 0
        if self._steady >= _LOST_CYCLES:
            owed, self._steady = owed - 1, 0
        self._owed = min(owed, _MOST_OWED)

    def _end_of_some(self) -> None:
        """Evaluate a PDO of every n-th SYNC. Its phase may move when a SYNC is received twice or missed; its rate does
        not double. After a late one the next comes as much sooner (`_owed`, here in cycles)."""
        taken = self._before + self._behind
        while taken and self.since + self._owed > self.every // 2:
            self._use(taken.pop(0), in_time=True)
            late = self.since - self.every
            silent = late > _MOST_OWED * self.every
            if late > 0:
                self._steady = 0
            self._owed = 0 if silent else max(0, self._owed + late)
            self.since = 0
        self._steady = self._steady + 1 if self._owed else 0
        if self._steady >= _LOST_CYCLES:
            self._owed = self._steady = 0
        self.surplus = _others(taken, self._used)

    def _use(self, data: bytes | None, *, in_time: bool) -> None:
        self.data = data
        if data is not None:
            self._used = data
        self.age_cycles = 0 if in_time else 1 if data is not None else self.age_cycles + 1


def _others(frames: Sequence[bytes], used: bytes) -> int:
    """Number of surplus frames; a single repetition of the data used is none: CAN itself may repeat a frame."""
    return 0 if len(frames) == 1 and frames[0] == used else len(frames)
