"""Idle times of a bench whose script does something else for a while: plots, waits for a person, computes.

In lockstep no time passes meanwhile, for the simulated devices as well, as long as the bench sends its heartbeat
(`hilbench.canopen.clock.SyncClock`). A small thread sends it between two cycles. When the process is stopped or gone,
or a cycle hangs, no heartbeat is sent, and devices and supervisor stop the drives as usual.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hilbench.topology.config import BenchConfig


def may_idle(config: BenchConfig) -> bool:
    """True if time can be stopped: with simulated drives only, in lockstep."""
    simulated = all(part.is_ours for part in config.parts)
    return config.pace == "lockstep" and simulated and config.master.heartbeat_ms > 0


@contextmanager
def meanwhile(act: Callable[[], None], period_s: float, name: str) -> Iterator[None]:
    """Call `act` every `period_s` of wall time, from a thread of its own called `name`, until the context is left."""
    left = threading.Event()

    def run() -> None:
        while not left.wait(period_s):
            act()

    thread = threading.Thread(target=run, name=name, daemon=True)
    thread.start()
    try:
        yield
    finally:
        left.set()
        thread.join()
