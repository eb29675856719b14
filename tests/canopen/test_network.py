"""canopen's network on the buses of hilbench: who leaves waits for nobody."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

import can
from hilbench.can.memory import MemoryBus, MemoryCanBus
from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen.network import Network

BUSES: dict[str, Callable[[], can.BusABC]] = {
    "in memory": lambda: MemoryCanBus(MemoryBus("left", 1_000_000)),
    "embedded": lambda: open_python_can(BusAddress(channel="hilbench_left")),
}


@pytest.mark.parametrize("bus", BUSES)
def test_its_thread_ends_though_it_would_wait_for_a_message_for_long(bus: str) -> None:
    before = set(threading.enumerate())
    network = Network(BUSES[bus]())
    network.NOTIFIER_CYCLE = 60.0
    network.connect()
    (receives,) = set(threading.enumerate()) - before
    network.disconnect()  # waits for it for 5 s
    assert not receives.is_alive()
