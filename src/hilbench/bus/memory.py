"""A bus inside one process: the same wire as the hub's, without processes, sockets or waiting.

Frames that are sent wait for the wire; they are carried, in arbitration order, when somebody receives. So what several
links send before anyone looks competes by identifier as on a real bus, and the same calls always give the same order.
Bus time is the time of the frames themselves, from 0. Links may be used from several threads.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any

from hilbench.bus.arbitration import accepts
from hilbench.bus.confinement import ControllerState, bus_off
from hilbench.bus.disturbance import Disturber, ErrorInjection
from hilbench.bus.embedded import can_record
from hilbench.bus.frame import Frame
from hilbench.bus.medium import FOREVER, Medium, Station
from hilbench.bus.messages import kernel_filters, to_frame, to_message
from hilbench.bus.python_can import can
from hilbench.bus.waiting import wait_readable
from hilbench.bus.wire import bits_on_wire
from hilbench.errors import BusError

#: Frames a link holds that does not read, before the newest are dropped.
RECEIVE_LIMIT = 16384


class MemoryBus:
    """A CAN wire for the links of one process; `bitrate` in bit/s."""

    def __init__(self, channel: str = "memory0", bitrate: int = 1_000_000) -> None:
        self.channel = channel
        self._medium = Medium(bitrate)
        self._links: list[MemoryLink] = []
        self._lock = threading.Lock()

    def open_link(self) -> MemoryLink:
        """A new station on the bus."""
        with self._lock:
            link = MemoryLink(self)
            self._links.append(link)
            self._medium.join(link.station)
        return link

    def open_python_can(self, **options: Any) -> MemoryCanBus:
        """A python-can bus on a new station (canopen's networks want one)."""
        return MemoryCanBus(self, **options)

    def inject_errors(self, injection: ErrorInjection) -> None:
        """Disturb the frames that are sent from now on."""
        with self._lock:
            self._medium.disturber = Disturber(injection)

    @property
    def bits(self) -> int:
        """Bit times the wire was taken so far."""
        with self._lock:
            self._carry()
            return self._medium.counters.bits

    def _carry(self) -> None:
        """Let the wire carry all that was sent; hand it to the links. The lock is held."""
        for delivery in self._medium.run(FOREVER):
            frame = Frame(delivery.can_id, delivery.payload, delivery.time_ns)
            for link in self._links:
                if link.station is not delivery.sender and link.controller is not ControllerState.BUS_OFF:
                    link.take(frame)


class MemoryLink:
    """A station of a MemoryBus, as the cyclic path wants it."""

    def __init__(self, bus: MemoryBus) -> None:
        self.channel = bus.channel
        self.dropped = 0
        self.station = Station()
        self._bus = bus
        self._filters: Sequence[tuple[int, int]] | None = None
        self._received: deque[Frame] = deque()
        self._event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # readable while a frame waits
        self._closed = False

    def send(self, frames: Sequence[Frame]) -> None:
        for frame in frames:
            can_record(frame.can_id, frame.data)  # refuses what no wire could carry
        bus = self._bus
        with bus._lock:
            self._check_open()
            for frame in frames:
                bits = bits_on_wire(frame.can_id, frame.data)
                bus._medium.queue(self.station, frame.can_id, bytes(frame.data), bits, bus._medium.free_ns)
            for link in bus._links:
                if link is not self and any(accepts(link._filters, frame.can_id) for frame in frames):
                    os.eventfd_write(link._event, 1)

    def take(self, frame: Frame) -> None:
        """A frame was on the wire (called by the bus)."""
        if not accepts(self._filters, frame.can_id):
            return
        if len(self._received) >= RECEIVE_LIMIT:
            self.dropped += 1
            return
        self._received.append(frame)

    def receive(self, timeout_s: float) -> list[Frame]:
        frames = self._waiting()
        deadline = time.monotonic() + timeout_s
        while not frames and (remaining := deadline - time.monotonic()) > 0:
            wait_readable(self._event, remaining)
            frames = self._waiting()
        return frames

    def _waiting(self) -> list[Frame]:
        with self._bus._lock:
            self._check_open()
            self._bus._carry()
            if self.controller is ControllerState.BUS_OFF:
                raise bus_off(self.channel)
            frames = list(self._received)
            self._received.clear()
            with contextlib.suppress(BlockingIOError):  # nothing was signalled
                os.eventfd_read(self._event)
            return frames

    def set_filters(self, identifiers: Sequence[tuple[int, int]] | None) -> None:
        with self._bus._lock:
            self._bus._carry()  # what was sent before meets the old filters
            self._filters = identifiers

    @property
    def controller(self) -> ControllerState:
        """State of this station's controller when the wire last carried something."""
        return self.station.state

    def fileno(self) -> int:
        return self._event

    def close(self) -> None:
        bus = self._bus
        with bus._lock:
            if self._closed:
                return
            bus._carry()  # its last frames still go out
            self._closed = True
            bus._links.remove(self)
            bus._medium.leave(self.station)
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
