"""A trace back onto a bus, in its own time."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.link import Link
from hilbench.canopen.identifiers import COB_ID, FUNCTION_CODE, NMT, RPDOS, SDO_REQUEST, SYNC

#: Function codes of what makes nodes do something (predefined connection set): NMT, RPDO1 to 4, SDO requests.
#: SYNC is one of them, too: synchronous RPDOs act on it.
_COMMANDS = frozenset({NMT, *RPDOS, SDO_REQUEST})
_NOT_SENT = ERROR_FLAG | REMOTE_FLAG
#: Frames due within so long go out together: a shorter wait is not kept by the machine anyway.
_TOGETHER_S = 0.0005


@dataclass
class Replayed:
    """Frames that were sent."""

    frames: int = 0
    left_out: int = 0
    latest_s: float = 0.0  #: largest lateness of a frame against its time in the trace


def is_command(frame: Frame) -> bool:
    """True if a frame is a command to nodes (by the predefined connection set)."""
    can_id = frame.can_id
    commands_something = can_id & FUNCTION_CODE in _COMMANDS or can_id & COB_ID == SYNC
    return commands_something and not can_id & (EXTENDED_FLAG | ERROR_FLAG)


def replay(frames: Iterable[Frame], link: Link, *, speed: float, commands: bool) -> Replayed:
    """Send frames as far apart as they were, `speed` times as fast; without `commands` only what nodes said.

    Error frames are left out: a bus makes its own; remote frames, too: nodes would answer. Raises BusError when the bus
    is lost.
    """
    done = Replayed()
    started_s, first_ns = time.monotonic(), None
    for batch in _batches(frames, speed):
        if first_ns is None:
            first_ns = batch[0].time_ns
        due_s = started_s + (batch[0].time_ns - first_ns) * 1e-9 / speed
        time.sleep(max(0.0, due_s - time.monotonic()))
        chosen = [frame for frame in batch if not frame.can_id & _NOT_SENT and (commands or not is_command(frame))]
        link.send(chosen)
        link.receive(0.0)  # what others say is not kept, and must not pile up
        done.frames += len(chosen)
        done.left_out += len(batch) - len(chosen)
        done.latest_s = max(done.latest_s, time.monotonic() - due_s)
    return done


def _batches(frames: Iterable[Frame], speed: float) -> Iterator[list[Frame]]:
    batch: list[Frame] = []
    for frame in frames:
        if batch and (frame.time_ns - batch[0].time_ns) * 1e-9 / speed > _TOGETHER_S:
            yield batch
            batch = []
        batch.append(frame)
    if batch:
        yield batch
