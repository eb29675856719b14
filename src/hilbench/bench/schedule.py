"""Worst-case schedule of a cycle: SYNC, the answers as CAN arbitrates them, set points before the next SYNC.

All devices have their answers ready at SYNC; the lowest identifier goes first, and a frame that has begun is not
interrupted. So an answer is over, at the latest, after SYNC, the longest frame of a lower priority (which had just
begun), all answers of a higher priority and itself, every possible stuff bit counted: the response time of a frame
that is sent once a period (Davis, Burns, Bril, Lukkien: Controller Area Network (CAN) schedulability analysis, 2007).
A frame that is not in every cycle counts whole. Set points are sent when the answers are over, or not waited for any
longer; a heartbeat may have begun then. Emergencies and SDO transfers are no part of a cycle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hilbench.can.load import CyclicFrame, bits_on_wire
from hilbench.canopen.identifiers import FUNCTION_CODE, HEARTBEAT, RPDOS, SYNC
from hilbench.exchange.pacing import GUARD_FRACTION


@dataclass(frozen=True)
class Slot:
    """A frame of a cycle. `ends_s`: after SYNC began, of a set point after the bench began to send them, at worst;
    `due_s`: until then it is waited for, or the next SYNC is due, in real time."""

    name: str
    can_id: int
    ends_s: float
    due_s: float
    is_set_point: bool

    @property
    def fits(self) -> bool:
        """True if it is in time in each cycle."""
        return self.ends_s <= self.due_s


def schedule(
    frames: Sequence[CyclicFrame],
    cycle_s: float,
    bitrate: int,
    bits_of: Callable[[CyclicFrame], float] = bits_on_wire,
) -> list[Slot]:
    """Schedule all frames of a cycle (`Nodes.cyclic_frames`) in the order of the wire: SYNC, answers, then set points.
    `bits_of`: bit times of a frame."""
    rpdos = [frame for frame in frames if frame.can_id & FUNCTION_CODE in RPDOS]
    at_any_time = [frame for frame in frames if frame.can_id & FUNCTION_CODE == HEARTBEAT]
    answers = sorted((f for f in frames if f not in rpdos and f not in at_any_time), key=lambda frame: frame.can_id)
    slots: list[Slot] = []
    before = 0.0
    for place, frame in enumerate(answers):
        # No answer is sent before SYNC, but a heartbeat may have begun.
        lower = [*at_any_time, *(answers[place + 1 :] if frame.can_id != SYNC else [])]
        blocked = max((bits_of(other) for other in lower), default=0.0)
        ends_s = (before + blocked + bits_of(frame)) / bitrate
        slots.append(Slot(frame.name, frame.can_id, ends_s, (1.0 - GUARD_FRACTION) * cycle_s, False))
        before += bits_of(frame)
    blocked, before = max((bits_of(frame) for frame in at_any_time), default=0.0), 0.0
    for frame in rpdos:  # the bench's alone, sent in this order
        before += bits_of(frame)
        slots.append(Slot(frame.name, frame.can_id, (blocked + before) / bitrate, GUARD_FRACTION * cycle_s, True))
    return slots
