"""Fast path of a process that holds simulated drives on the embedded bus: packets in, packets out, on arrays.

The frames of the last SYNC are expected with the next one: the same in the same order, controlwords that
leave the drives enabled, now and then the bench's heartbeat. Then `kernel` does the work of the devices. Anything else
that comes, or is due, is for the host, which is the reference: before it the objects are updated from the arrays.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Protocol

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.host import DeviceHost, HostedDevices
from hilbench.canopen.identifiers import HEARTBEAT, LAST_NODE, SYNC
from hilbench.compiled import load
from hilbench.fast_path import kernel, packet_kernel
from hilbench.fast_path.tables import FastPathRefusedError
from hilbench.real_time import ProcessSettings, kept_ready

#: Serve calls after which the fast path is tried again after a refusal.
_LOOK_AGAIN = 8


class PacketRun(Protocol):
    """Fast-path cycles one after the other, from objects into arrays and back."""

    @property
    def came(self) -> Sequence[bytes]:
        """Packets left for the host once `serve` returns False."""

    def serve(self, timeout_s: float) -> bool:
        """Serve the next packet, if one comes within the time; False where it, or what is due, does not fit the
        fast path: it is left to the host, and nothing was done with it."""

    def end(self) -> None:
        """The objects get what the arrays have."""


class Application(Protocol):
    """Application of the simulated devices."""

    #: Identifiers of the answers to a SYNC that it receives.
    listens_to: frozenset[int]

    @property
    def fits_fast_path(self) -> bool:
        """True if it is advanced by SYNC alone, and is between two cycles."""


class FastPathHost:
    """Serves the devices of a host, by packets where its cycles fit the fast path.

    `begin` makes a run that expects these frames with each SYNC, SYNC the last; raises FastPathRefusedError.
    """

    def __init__(
        self,
        host: DeviceHost,
        link: EmbeddedLink,
        application: Application,
        begin: Callable[[Sequence[Frame]], PacketRun],
    ) -> None:
        warm_up_packets()
        self._host, self._link = host, link
        self._application, self._new_run = application, begin
        self._run: PacketRun | None = None
        self._expected: Sequence[Frame] = ()  # what came with the last SYNC
        self._wait = 0  # serve calls until it is tried again

    def serve(self, timeout_s: float) -> None:
        """Serve the devices for up to `timeout_s`, like `DeviceHost.serve`."""
        run = self._run
        if run is not None:
            if run.serve(timeout_s):
                return
            self.settle()
            frames = self._link.frames_from(*run.came)
        else:
            frames = self._link.frames_from(self._link.receive_packet(timeout_s))
        self._host.handle(frames)
        self._note(frames)
        if self._wait:
            self._wait -= 1
        elif frames and self._expected and self._host.fits_fast_path and self._application.fits_fast_path:
            self._begin()
            self._wait = _LOOK_AGAIN

    def settle(self) -> None:
        """Give the objects what the arrays have."""
        run, self._run = self._run, None
        if run is not None:
            run.end()
            self._host.served_until(time.monotonic())

    def _note(self, frames: Sequence[Frame]) -> None:
        """Remember the frames that come with a SYNC; none where there are two."""
        cob_ids = [frame.can_id for frame in frames]
        syncs = cob_ids.count(SYNC)
        if syncs:
            with_it = frames[: cob_ids.index(SYNC) + 1] if syncs == 1 else ()
            strange = self._application.listens_to
            self._expected = [frame for frame in with_it if not (is_heartbeat(frame.can_id) or frame.can_id in strange)]

    def _begin(self) -> None:
        try:
            self._run = self._new_run(self._expected)
        except FastPathRefusedError:
            self._run = None


def warm_up_packets() -> None:
    """Compile, or load, what serves devices by packets."""
    load(kernel.publish, packet_kernel.answer, packet_kernel.hear)


def run_devices(
    bus: BusAddress,
    hosted: HostedDevices,
    fast_path_host: Callable[[DeviceHost, Link], FastPathHost | None],
    process: ProcessSettings | None,
    stop: Callable[[], bool],
    say: Callable[[str], None],
) -> int | None:
    """Run devices on a bus until `stop` returns True; `fast_path_host` makes the server of fast-path cycles.

    Returns how many frames were lost because they were not read in time (None: unknown on this bus). Raises BusError
    when the bus is lost.
    """
    with closing(open_link(bus)) as link:
        host = DeviceHost(link, *hosted)
        fast_path = fast_path_host(host, link)
        with kept_ready(process, say):
            host.run(stop, None if fast_path is None else fast_path.serve)
    return link.dropped


def is_heartbeat(can_id: int) -> bool:
    """True if an identifier is that of a node's heartbeat."""
    return HEARTBEAT < can_id <= HEARTBEAT + LAST_NODE
