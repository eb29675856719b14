"""The supervisor beside whatever else is on the bus."""

from __future__ import annotations

import threading

from hilbench.bench.lifecycle.supervisor import Watch, watch_heartbeat
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus
from hilbench.can.open import BusAddress
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID

LIMIT_S = 0.1


def test_only_the_heartbeat_of_the_bench_is_watched() -> None:
    """What booting nodes send before the supervisor has its filter must not count as a bench that fell silent."""
    bus = MemoryBus()
    node, supervisors = bus.open_link(), bus.open_link()
    node.send([Frame(0x701, b"\x00")])
    node.receive(0.0)  # carried: it waits at the supervisor's link now
    told_to_end = threading.Event()
    watch = Watch(BusAddress(), 127, LIMIT_S)
    thread = threading.Thread(target=watch_heartbeat, args=(supervisors, watch, told_to_end, threading.Event()))
    thread.start()
    try:
        assert node.receive(4 * LIMIT_S) == []
        node.send([Frame(0x77F, b"\x05")])
        assert node.receive(20.0)[0].can_id == EMERGENCY_STOP_COB_ID
    finally:
        told_to_end.set()
        thread.join()
