"""The clock of simulated devices and virtual axes."""

from __future__ import annotations

from hilbench.canopen.clock import Clock, MonotonicClock, SyncClock
from hilbench.canopen.identifiers import HEARTBEAT
from hilbench.topology.config import BenchConfig


def device_clock(config: BenchConfig) -> Clock:
    """The time base of simulated devices: SYNC in lockstep, else the monotonic clock."""
    if config.pace != "lockstep":
        return MonotonicClock()
    return SyncClock(config.cycle_ns, kept_by=HEARTBEAT + config.master.node_id if config.master.heartbeat_ms else None)
