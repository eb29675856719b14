"""The supervisor: a process of its own that stops the drives when the bench's cyclic loop stalls.

The bench's heartbeat comes from its cyclic loop, so its silence shows that the loop has stalled, whatever the reason
(the process was stopped or killed, it waits for something, the machine is overloaded). Drives that watch 1016h stop by
themselves then; the supervisor stops those that don't, and those that are watched too loosely, by the emergency stop.
Nothing is imported here that it does not need for that: it starts with every bench.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass

from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.emergency_stop import send_emergency_stop
from hilbench.canopen.identifiers import COB_ID, HEARTBEAT
from hilbench.errors import BusError

_MODULE = "hilbench.bench.lifecycle.supervisor"
_LOOK_S = 0.05


@dataclass(frozen=True)
class Watch:
    """Heartbeat that a supervisor watches: that of `node_id`, with a time-out of `limit_s` of wall time."""

    bus: BusAddress
    node_id: int
    limit_s: float

    def arguments(self) -> list[str]:
        """The command line of the supervisor's process, after ``python -m``."""
        bus = self.bus
        return [_MODULE, str(bus), str(bus.bitrate), bus.timing, str(self.node_id), repr(self.limit_s)]

    @classmethod
    def parse(cls, arguments: Sequence[str]) -> Watch:
        """Parse the arguments after the module's name."""
        address, bitrate, timing, node_id, limit_s = arguments
        return cls(BusAddress.parse(address, bitrate=int(bitrate), timing=timing), int(node_id), float(limit_s))


def supervise(watch: Watch) -> None:
    """Watch the bench until SIGTERM; an end of the bench without that is a reason to stop the drives.

    Raises BusError when the bus is lost.
    """
    asked_to_end, bench_lost = threading.Event(), threading.Event()
    # Ctrl-C is the bench's to handle, which ends us afterwards.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: asked_to_end.set())
    threading.Thread(target=_follow, args=(bench_lost,), name="follow-bench", daemon=True).start()
    with closing(open_link(watch.bus)) as link:
        watch_heartbeat(link, watch, asked_to_end, bench_lost)


def _follow(bench_lost: threading.Event) -> None:
    while os.read(0, 4096):
        pass
    bench_lost.set()


def watch_heartbeat(link: Link, watch: Watch, asked_to_end: threading.Event, bench_lost: threading.Event) -> None:
    """Stop the drives over `link` when the heartbeat, once received, stays away, or the bench is gone."""
    heartbeat = HEARTBEAT + watch.node_id
    link.set_filters([(heartbeat, COB_ID)])
    received_s: float | None = None  # None: not received yet, or stopped already
    while not asked_to_end.is_set():
        # Others' frames may have come before the filter was there: while the nodes boot the bench sends no heartbeat.
        if any(frame.can_id == heartbeat for frame in link.receive(_LOOK_S)):
            received_s = time.monotonic()
        if bench_lost.is_set() and not asked_to_end.is_set():
            _stop(link, "the bench's process has ended")
            return
        if received_s is not None and time.monotonic() - received_s > watch.limit_s:
            _stop(link, f"no heartbeat of the bench for {watch.limit_s:g} s")
            received_s = None


def _stop(link: Link, reason: str) -> None:
    print(f"emergency stop: {reason}", file=sys.stderr, flush=True)
    send_emergency_stop(link)


def main() -> None:
    """Entry point of the process: errors are one line in its log."""
    try:
        supervise(Watch.parse(sys.argv[1:]))
    except BusError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
