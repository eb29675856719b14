"""A bus inside one process: the same wire as the hub's, without processes, sockets or waiting.

Frames that are sent wait for the wire; they are carried, in arbitration order, when a link receives. So frames that
several links send before that compete by identifier as on a real bus, and the same calls always give the same order.
Bus time is the time of the frames themselves, from 0. Links may be used from several threads.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from hilbench.can.adapter import kernel_filters, to_frame, to_message
from hilbench.can.confinement import ControllerState, bus_off
from hilbench.can.disturbance import Disturber, ErrorInjection
from hilbench.can.embedded import check_frame
from hilbench.can.frame import Frame
from hilbench.can.medium import FOREVER, Listeners, Medium, Station
from hilbench.can.python_can import can
from hilbench.can.wire import bits_on_wire
from hilbench.errors import BusError

#: Frames a link holds that does not read, before the newest are dropped.
RECEIVE_LIMIT = 16384


def _nobody() -> None:
    """Do nothing: no fast path runs."""


class MemoryBus:
    """A CAN wire for the links of one process; `bitrate` in bit/s."""

    def __init__(self, channel: str = "memory0", bitrate: int = 1_000_000) -> None:
        self.channel = channel
        self._medium = Medium(bitrate)
        self.account = self._medium.account  #: frames that the fast path has carried, and delivered
        self._links: list[MemoryLink] = []
        self._listeners = Listeners(lambda: self._links)
        self.hear = self._listeners.of  #: the links whose filters let an identifier pass
        self._lock = threading.Lock()
        self.waiting = False  #: true if frames wait for the wire
        #: Called before a link sends, receives, opens or closes, so that the fast path hands its state back.
        self.before_use: Callable[[], None] = _nobody

    def open_link(self) -> MemoryLink:
        """A new station on the bus."""
        return MemoryLink(self)

    def open_python_can(self, **options: Any) -> MemoryCanBus:
        """A python-can bus on a new station (canopen's networks want one)."""
        return MemoryCanBus(self, **options)

    def inject_errors(self, injection: ErrorInjection) -> None:
        """Disturb the frames that are sent from now on."""
        self.before_use()
        with self._lock:
            self._medium.disturber = Disturber(injection)

    @property
    def bits(self) -> int:
        """Bit times the wire was taken so far."""
        self.before_use()
        with self._lock:
            self._carry()
            return self._medium.counters.bits

    @property
    def quiet(self) -> bool:
        """True if no frame is under way, and frames are not disturbed."""
        return not self.waiting and self._medium.undisturbed

    def _carry(self) -> None:
        """Let the wire carry all frames sent, and deliver them to the links. The lock is held."""
        if not self.waiting:
            return
        self.waiting = False
        for sender, can_id, data, time_ns in self._medium.run(FOREVER):
            frame = Frame(can_id, data, time_ns)
            for link in self._listeners.of(can_id):
                if link.station is not sender and link.controller is not ControllerState.BUS_OFF:
                    link.take(frame)


class MemoryLink:
    """A new station of a MemoryBus, as the cyclic path wants it."""

    def __init__(self, bus: MemoryBus) -> None:
        self.channel = bus.channel
        self.dropped = 0
        self.station = Station()
        self._bus = bus
        self.filters: Sequence[tuple[int, int]] | None = None
        self._received: list[Frame] = []
        self._sent = threading.Condition(bus._lock)  # a frame that the filters let pass was sent
        self._waiting_threads = 0  # for that
        self._event: int | None = None  # for `fileno`: readable while a frame waits
        self._closed = False
        bus.before_use()
        with bus._lock:
            bus._links.append(self)
            bus._listeners.forget()
            bus._medium.join(self.station)

    def send(self, frames: Sequence[Frame]) -> None:
        for can_id, data, _ in frames:
            check_frame(can_id, data)
        bus = self._bus
        bus.before_use()
        with bus._lock:
            self._check_open()
            medium = bus._medium
            bus.waiting = True
            station, queue, free_ns = self.station, medium.queue, medium.free_ns
            for can_id, data, _ in frames:
                content = bytes(data)
                queue(station, can_id, content, bits_on_wire(can_id, content), free_ns)
            for link in [link for link in bus._links if link is not self and link._is_awaited()]:
                if any(link in bus._listeners.of(frame.can_id) for frame in frames):
                    link._publish()

    def take(self, frame: Frame) -> None:
        """A frame was on the wire (called by the bus)."""
        if len(self._received) >= RECEIVE_LIMIT:
            self.dropped += 1
            return
        self._received.append(frame)

    @property
    def holds_frames(self) -> bool:
        """True if a frame waits to be read, or a thread waits for one."""
        return bool(self._received) or self._is_awaited() or self._closed

    def receive(self, timeout_s: float) -> list[Frame]:
        # Only reading does not use the bus: the senders of the frames have called `before_use`.
        with self._bus._lock:
            frames = self._waiting()
            if frames or timeout_s <= 0.0:
                return frames
            deadline_s = time.monotonic() + timeout_s
            while not frames and (remaining_s := deadline_s - time.monotonic()) > 0:
                self._waiting_threads += 1
                self._sent.wait(remaining_s)
                self._waiting_threads -= 1
                frames = self._waiting()
            return frames

    def _waiting(self) -> list[Frame]:
        """Frames received. The lock is held."""
        self._check_open()
        self._bus._carry()
        if self.controller is ControllerState.BUS_OFF:
            raise bus_off(self.channel)
        if self._event is not None:
            with contextlib.suppress(BlockingIOError):  # nothing was signalled
                os.eventfd_read(self._event)
        frames, self._received = self._received, []
        return frames

    def _is_awaited(self) -> bool:
        return self._waiting_threads > 0 or self._event is not None

    def _publish(self) -> None:
        self._sent.notify_all()
        if self._event is not None:
            os.eventfd_write(self._event, 1)

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        self._bus.before_use()
        with self._bus._lock:
            self._bus._carry()  # what was sent before meets the old filters
            self.filters = identifiers
            self._bus._listeners.forget()

    @property
    def controller(self) -> ControllerState:
        """State of this station's controller when the wire last carried something."""
        return self.station.state

    def fileno(self) -> int:
        self._bus.before_use()
        with self._bus._lock:
            self._check_open()
            if self._event is None:
                self._bus._carry()
                self._event = os.eventfd(1 if self._received else 0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            return self._event

    def close(self) -> None:
        bus = self._bus
        bus.before_use()
        with bus._lock:
            if self._closed:
                return
            bus._carry()  # its last frames still go out
            self._closed = True
            bus._links.remove(self)
            bus._listeners.forget()
            bus._medium.leave(self.station)
            self._sent.notify_all()
            if self._event is not None:
                os.close(self._event)

    def _check_open(self) -> None:
        if self._closed:
            raise BusError(f"{self.channel}: this link is closed")


class MemoryCanBus(can.BusABC):
    """A python-can bus on a MemoryBus."""

    def __init__(self, bus: MemoryBus, can_filters: can.typechecking.CanFilters | None = None, **kwargs: Any) -> None:
        self._link = bus.open_link()
        self._received: deque[Frame] = deque()
        self.channel_info = f"hilbench memory bus {bus.channel}"
        super().__init__(bus.channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        try:
            self._link.send([to_frame(msg)])
        except (BusError, ValueError) as error:
            raise can.CanOperationError(str(error)) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            try:
                self._received.extend(self._link.receive(3600.0 if timeout is None else timeout))
            except BusError as error:
                raise can.CanOperationError(str(error)) from error
        if not self._received:
            return None, True
        return to_message(self._received.popleft(), self._link.channel), True

    def _apply_filters(self, filters: can.typechecking.CanFilters | None) -> None:
        self._link.set_filters(kernel_filters(filters))

    def shutdown(self) -> None:
        super().shutdown()
        self._link.close()
