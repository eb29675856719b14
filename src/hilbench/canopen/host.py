"""The event loop of a process that holds devices: one link, one clock, one application behind them.

All frames that the devices send for a SYNC are one batch: first those pending by timers and errors, then
the synchronous TPDOs. With a clock that follows SYNC, a frame that arises after that batch waits for the next one, so
that it belongs to the same cycle on every machine; answers to SDO requests never wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import floor
from typing import NamedTuple, Protocol

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.link import Link
from hilbench.canopen.clock import Clock, SyncClock
from hilbench.canopen.device import Device
from hilbench.canopen.identifiers import LAST_NODE, NMT, SDO_REQUEST, NmtState
from hilbench.canopen.sdo_server import may_write

_ERROR_PASSIVE = 0x8120  #: EMCY error code: CAN in error passive mode
_COMMUNICATION_ERROR = 0x11  #: error register (1001h): generic and communication
_EXACTLY = 0x1FFFFFFF | EXTENDED_FLAG | REMOTE_FLAG
_POLL_S = 0.005
_TICK_S = 0.002
_TICK_STEP_S = 0.001
_LONGEST_TICK_S = 0.05


class Application(Protocol):
    """Application of the devices of a host."""

    #: Identifiers of the frames, other than SYNC, that `on_frame` receives.
    listens_to: frozenset[int]

    def before_sync(self, behind: int) -> None:
        """React to a SYNC after which `behind` more wait; the devices have not sampled yet."""

    def after_sync(self) -> None:
        """The TPDOs of this SYNC are out and set points have acted: advance to the next one."""

    def on_frame(self, frame: Frame) -> None:
        """A frame that it listens to, after the devices have seen it."""

    def tick(self, duration_s: float) -> None:
        """Advance by `duration_s` of wall time in which no SYNC is running."""


class HostedDevices(NamedTuple):
    """Devices of a host, with their clock and application."""

    devices: Sequence[Device]
    clock: Clock
    application: Application


class DeviceHost:
    """Runs devices and their application on a link until `stop()` is true."""

    def __init__(self, link: Link, devices: Sequence[Device], clock: Clock, application: Application) -> None:
        self._link = link
        self._devices = list(devices)
        self._clock = clock
        self._application = application
        self._sync_clock = clock if isinstance(clock, SyncClock) else None
        self._follows_sync = self._sync_clock is not None
        self._sync_running = False
        self._addressees: dict[int, list[Device]] = {}  # by identifier
        self._wanted: set[int] = set()  # identifiers that the link lets pass
        self._ticked_s = time.monotonic()
        self._passive = False

    def run(self, stop: Callable[[], bool], serve: Callable[[float], None] | None = None) -> None:
        """Boot the devices and serve until `stop()`. Raises BusError when the bus is lost.

        `serve`: used in place of this host's, which it may call.
        """
        serve = self.serve if serve is None else serve
        self.boot()
        while not stop():
            serve(_POLL_S if self._sync_running else _TICK_S)

    def boot(self) -> None:
        """Let the devices send boot-up."""
        self._listen()
        for device in self._devices:
            device.boot()
        self._flush_all()

    def serve(self, timeout_s: float) -> None:
        """Handle frames received within `timeout_s`, and timers that are due."""
        self.handle(self._link.receive(timeout_s))

    def handle(self, frames: Sequence[Frame]) -> None:
        """Handle all that has come, and what time has made due."""
        self._look_at_controller()
        sync_cob_id = self._devices[0].sync_cob_id
        behind = [frame.can_id for frame in frames].count(sync_cob_id)
        listens_to, sync_clock = self._application.listens_to, self._sync_clock
        operational = NmtState.OPERATIONAL.heartbeat
        for frame in frames:
            can_id = frame.can_id
            if can_id == sync_cob_id:
                behind -= 1
                self._sync(frame, behind)
                continue
            if sync_clock is not None and can_id == sync_clock.kept_by and frame.data == operational:
                sync_clock.keep()
            devices = self._addressees.get(can_id, ())
            for device in devices:
                device.handle(frame)
            if can_id in listens_to:
                self._application.on_frame(frame)
            if can_id == NMT or (SDO_REQUEST < can_id <= SDO_REQUEST + LAST_NODE and may_write(frame.data)):
                self._listen()  # before the answer goes out
            if devices:
                self._flush_replies()
            if can_id == NMT:  # started nodes wait for SYNC; what was pending goes now, not with their first answers
                self._flush_all()
                if any(device.nmt_state is NmtState.OPERATIONAL for device in self._devices):
                    self._clock.expect_sync()
        self._time_passes()

    @property
    def fits_fast_path(self) -> bool:
        """True if SYNC is running, and every device has `Device.fits_fast_path`."""
        return self._sync_running and not self._passive and all(d.fits_fast_path for d in self._devices)

    def addressees(self, can_id: int) -> Sequence[Device]:
        """The devices that an identifier means something to."""
        return self._addressees.get(can_id, ())

    def served_until(self, monotonic_s: float) -> None:
        """Account for SYNCs handled by the fast path until then."""
        self._ticked_s = monotonic_s

    def _look_at_controller(self) -> None:
        """Report error passive (EMCY 8120h of CiA 301) of the controller in every device, or clear it."""
        passive = self._link.controller is not ControllerState.ERROR_ACTIVE
        if passive is self._passive:
            return
        self._passive = passive
        for device in self._devices:
            if passive:
                device.emergency(_ERROR_PASSIVE, _COMMUNICATION_ERROR)
            else:
                device.clear_emergency(_ERROR_PASSIVE)

    def _listen(self) -> None:
        """Receive what the devices and the application want as they are configured now, as a CAN controller would."""
        addressees: dict[int, list[Device]] = {}
        for device in self._devices:
            for identifier in device.identifiers():
                addressees.setdefault(identifier, []).append(device)
        wanted = {*addressees, *self._application.listens_to, self._devices[0].sync_cob_id}
        if self._sync_clock is not None and self._sync_clock.kept_by is not None:
            wanted.add(self._sync_clock.kept_by)
        self._addressees = addressees
        if wanted != self._wanted:
            self._wanted = wanted
            self._link.set_filters([(identifier, _EXACTLY) for identifier in sorted(wanted)])

    def _sync(self, frame: Frame, behind: int) -> None:
        starts, self._sync_running = not self._sync_running, True
        self._clock.tick()
        if starts and self._follows_sync:
            for device in self._devices:
                device.rephase()
        self._application.before_sync(behind)
        for device in self._devices:
            device.poll()
            device.sync(frame.data)
        self._flush_all()
        self._application.after_sync()
        if not self._follows_sync:
            self._flush_all()

    def _time_passes(self) -> None:
        if self._clock.stalled_ns():
            self._sync_running = False
            now_s = time.monotonic()
            elapsed_s = now_s - self._ticked_s
            if elapsed_s >= _TICK_S:
                whole_s = round(floor(elapsed_s / _TICK_STEP_S) * _TICK_STEP_S, 3)
                self._ticked_s += whole_s  # the rest belongs to the next tick
                self._application.tick(min(whole_s, _LONGEST_TICK_S))
        else:
            self._ticked_s = time.monotonic()
            if self._follows_sync:
                return
        for device in self._devices:
            device.poll()
        self._flush_all()

    def _flush_replies(self) -> None:
        for device in self._devices:
            if device.replies:
                frames, device.replies = device.replies, []
                self._link.send(frames)

    def _flush_all(self) -> None:
        frames: list[Frame] = []
        for device in self._devices:
            if device.replies or device.outbox:
                frames += device.replies
                frames += device.outbox
                device.replies, device.outbox = [], []
        if frames:
            self._link.send(frames)
