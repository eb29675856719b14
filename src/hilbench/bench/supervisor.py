"""The supervisor: a process of its own that stops the drives when the bench's cyclic loop does not go on.

The bench's heartbeat comes from its cyclic loop, so its silence says that the loop has stalled, whatever the reason
(the process was stopped or killed, it waits for something, the machine is overloaded). Drives that watch 1016h stop by
themselves then; the supervisor stops those that don't, and those that are watched too loosely, by the emergency stop.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time

from hilbench.bench.config import BenchConfig
from hilbench.bus.link import Link
from hilbench.bus.open import open_link
from hilbench.errors import BusError
from hilbench.fieldbus.emergency_stop import EMERGENCY_STOP

_HEARTBEAT = 0x700
_STANDARD_MASK = 0x7FF
_LOOK_S = 0.05
#: The stop is sent so often: a frame can be lost.
_TIMES = 3


def silence_limit_s(config: BenchConfig) -> float:
    """How long the bench's heartbeat may stay away, wall time. In lockstep the bench waits for its participants."""
    safety = config.safety
    lockstep = config.pace == "lockstep"
    return safety.supervisor_timeout_s + (safety.cycle_timeout_s if lockstep else 0.0)


def supervise(config: BenchConfig) -> None:
    """Watch the bench on its bus until SIGTERM; an end of the bench without that is a reason to stop the drives.

    Raises BusError when the bus is lost.
    """
    told_to_end, bench_gone = threading.Event(), threading.Event()
    # Ctrl-C is the bench's to handle, which ends us afterwards.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: told_to_end.set())
    threading.Thread(target=_follow, args=(bench_gone,), name="follow-bench", daemon=True).start()
    link = open_link(config.bus_address)
    try:
        _watch(link, _HEARTBEAT + config.master.node_id, silence_limit_s(config), told_to_end, bench_gone)
    finally:
        link.close()


def _follow(bench_gone: threading.Event) -> None:
    while os.read(0, 4096):
        pass
    bench_gone.set()


def _watch(link: Link, cob_id: int, limit_s: float, told_to_end: threading.Event, bench_gone: threading.Event) -> None:
    link.set_filters([(cob_id, _STANDARD_MASK)])
    heard_s: float | None = None  # None: not heard yet, or stopped already
    while not told_to_end.is_set():
        if link.receive(_LOOK_S):
            heard_s = time.monotonic()
        if bench_gone.is_set() and not told_to_end.is_set():
            _stop(link, "the bench's process is gone")
            return
        if heard_s is not None and time.monotonic() - heard_s > limit_s:
            _stop(link, f"no heartbeat of the bench for {limit_s:g} s")
            heard_s = None


def _stop(link: Link, reason: str) -> None:
    print(f"emergency stop: {reason}", file=sys.stderr, flush=True)
    for attempt in range(_TIMES):
        try:
            link.send(EMERGENCY_STOP)
        except BusError:
            if attempt == _TIMES - 1:
                raise
        time.sleep(0.01)
