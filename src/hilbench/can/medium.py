"""The wire itself, without any input or output: stations with transmit queues, arbitration, bus time, disturbances.

Both emulations use it: the hub (frames between processes) and `memory.MemoryBus` (inside one process).
One frame at a time is on the wire. When it is free, the heads of all transmit queues compete; the lowest arbitration
field wins (two stations with the same one: the first to join). A frame that has begun is only interrupted by an
error frame: then its transmitter and the others count errors, and a station whose counter is full is off the bus until
it joins again (as a SocketCAN interface without restart-ms).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from hilbench.can.confinement import ControllerState, ErrorCounters
from hilbench.can.disturbance import Disturber, FrameOutcome
from hilbench.can.frame import accepts, priority
from hilbench.can.wire import ERROR_FRAME_BITS

_KNOWN_IDENTIFIERS = 4096


class _Filtered(Protocol):
    @property
    def filters(self) -> Sequence[tuple[int, int]] | None: ...


Listener = TypeVar("Listener", bound=_Filtered)


class Listeners(Generic[Listener]):
    """Cache of the stations of `present` whose filters let an identifier pass, until `forget`."""

    def __init__(self, present: Callable[[], Iterable[Listener]]) -> None:
        self._present = present
        self._known: dict[int, list[Listener]] = {}

    def of(self, can_id: int) -> list[Listener]:
        """Receivers of `can_id` (with its flag bits)."""
        found = self._known.get(can_id)
        if found is None:
            if len(self._known) >= _KNOWN_IDENTIFIERS:
                self._known.clear()
            found = self._known[can_id] = [one for one in self._present() if accepts(one.filters, can_id)]
        return found

    def forget(self) -> None:
        """Forget receivers: a station has joined or left, or changed its filters."""
        self._known.clear()


#: A point in time no bus reaches: `Medium.run(FOREVER)` sends all that is queued.
FOREVER = 1 << 63


class QueuedFrame(NamedTuple):
    """A frame in a station's transmit queue. `payload` is whatever the emulation delivers."""

    priority: int
    can_id: int
    payload: Any
    bits: int
    duration_ns: int
    ready_ns: int
    outcome: FrameOutcome | None


class Delivery(NamedTuple):
    """A frame whose last bit (of the intermission) was over at `time_ns`."""

    sender: Station
    can_id: int
    payload: Any
    time_ns: int


# A NamedTuple's own constructor takes twice as long, and these are made for every frame.
_queued_frame = partial(tuple.__new__, QueuedFrame)
_delivery = partial(tuple.__new__, Delivery)


class Station:
    """A controller on the wire: its frames leave in the order in which they were queued."""

    __slots__ = ("errors", "queue", "state")

    def __init__(self) -> None:
        self.queue: deque[QueuedFrame] = deque()
        self.errors = ErrorCounters()
        self.state = ControllerState.ERROR_ACTIVE  #: what `errors` meant when it was last looked at


@dataclass
class Counters:
    """Counters of the wire since the emulation began."""

    frames: int = 0
    bits: int = 0
    error_frames: int = 0
    lost: int = 0


class Medium:
    """One emulated CAN wire. `free_ns` is the bus time at which the last frame was over."""

    def __init__(self, bitrate: int, start_ns: int = 0) -> None:
        self.bitrate = bitrate
        self.start_ns = start_ns
        self.free_ns = start_ns
        self.counters = Counters()
        self.disturber: Disturber | None = None
        self.changed: list[Station] = []  #: stations whose state has changed; emptied by the code that reports it
        self._counting = False  # some station has errors counted: only then is every frame counted, too
        self.stations: list[Station] = []  #: on the wire, in the order in which they joined
        self._sender: Station | None = None  # the station that is sending
        self._end_ns = 0  # when its frame, or its error frame, is over

    def join(self, station: Station) -> None:
        self.stations.append(station)

    def leave(self, station: Station) -> None:
        """Take a station off the wire; what is in its queue is not sent."""
        self.stations.remove(station)
        if self._sender is station:
            self._sender = None
            self.free_ns = self._end_ns

    def queue(self, station: Station, can_id: int, payload: Any, bits: int, arrival_ns: int) -> None:
        """Append a frame of `bits` bit times to the station's queue; it competes from `arrival_ns` on.

        What a station sends that is bus off is lost.
        """
        if station.state is ControllerState.BUS_OFF:
            self.counters.lost += 1
            return
        outcome = self.disturber.draw(can_id, bits) if self.disturber is not None else None
        if outcome is not None:
            arrival_ns += outcome.delay_ns
        duration_ns = bits * 1_000_000_000 // self.bitrate
        station.queue.append(_queued_frame((priority(can_id), can_id, payload, bits, duration_ns, arrival_ns, outcome)))

    def run(self, until_ns: int) -> list[Delivery]:
        """Let time pass until `until_ns`; returns the frames completed by then, in order."""
        delivered: list[Delivery] = []
        while (self._sender is not None or self._arbitrate(until_ns)) and self._end_ns <= until_ns:
            self._finish(delivered)
        return delivered

    @property
    def undisturbed(self) -> bool:
        """True if nothing is queued or on the wire, no errors are counted, and frames are not disturbed."""
        return (
            self.disturber is None
            and self._sender is None
            and not self._counting
            and not any(station.queue for station in self.stations)
        )

    def account(self, frames: int, bits: int, duration_ns: int) -> None:
        """Count frames that went over the wire while it was undisturbed, one after the other."""
        self.counters.frames += frames
        self.counters.bits += bits
        self.free_ns += duration_ns

    def next_event_ns(self) -> int | None:
        """Time at which `run` has something to do next, if nothing more is queued; None: never."""
        if self._sender is not None:
            return self._end_ns
        waiting = [station.queue[0].ready_ns for station in self.stations if station.queue]
        return max(self.free_ns, min(waiting)) if waiting else None

    def _arbitrate(self, until_ns: int) -> bool:
        """Put the winner among the waiting heads on the wire, if one may begin by `until_ns`."""
        heads = [station for station in self.stations if station.queue]
        if not heads:
            return False
        winner = heads[0]
        frame = winner.queue[0]
        start = max(self.free_ns, frame.ready_ns)
        if len(heads) > 1:
            start = max(self.free_ns, min([station.queue[0].ready_ns for station in heads]))
            winner = min(
                (station for station in heads if station.queue[0].ready_ns <= start),
                key=lambda station: station.queue[0].priority,
            )
            frame = winner.queue[0]
        if start > until_ns:
            return False
        if frame.outcome is not None and frame.outcome.broken_off_after:
            bits = frame.outcome.broken_off_after[0] + ERROR_FRAME_BITS
            self._end_ns = start + bits * 1_000_000_000 // self.bitrate
        else:
            self._end_ns = start + frame.duration_ns
        self._sender = winner
        return True

    def _finish(self, delivered: list[Delivery]) -> None:
        """Complete the frame on the wire: count it, and deliver it or leave it at the head for its next attempt."""
        sender = self._sender
        assert sender is not None
        self._sender = None
        self.free_ns = self._end_ns
        frame = sender.queue.popleft()
        if frame.outcome is not None and not self._survives(sender, frame, frame.outcome):
            return
        self.counters.frames += 1
        self.counters.bits += frame.bits
        if self._counting:
            self._count(sender, failed=False)
        delivered.append(_delivery((sender, frame.can_id, frame.payload, self.free_ns)))

    def _survives(self, sender: Station, frame: QueuedFrame, outcome: FrameOutcome) -> bool:
        """Apply a disturbance; whether the frame that was on the wire reaches the others."""
        counters = self.counters
        if outcome.broken_off_after:
            counters.error_frames += 1
            counters.bits += outcome.broken_off_after[0] + ERROR_FRAME_BITS
            sender.queue.appendleft(
                frame._replace(outcome=outcome._replace(broken_off_after=outcome.broken_off_after[1:]))
            )
            self._count_failure(sender)
            return False
        if outcome.lost:
            counters.lost += 1
            counters.frames += 1
            counters.bits += frame.bits
            return False
        if outcome.duplicated:
            sender.queue.appendleft(frame._replace(outcome=None))
        return True

    def _count_failure(self, sender: Station) -> None:
        """An error frame has broken off what `sender` sent."""
        self._count(sender, failed=True)
        self._counting = True
        if sender.state is ControllerState.BUS_OFF:
            self.counters.lost += len(sender.queue)
            sender.queue.clear()

    def _count(self, sender: Station, *, failed: bool) -> None:
        """Count errors, or frames without one, of all stations: all see what `sender` sends."""
        for station in self.stations:
            if station is sender or station.state is not ControllerState.BUS_OFF:
                station.errors.count(own=station is sender, failed=failed)
            state = station.errors.state
            if state is not station.state:
                station.state = state
                self.changed.append(station)
        self._counting = not all(station.errors.clear for station in self.stations)
