"""Where the stations of a test meet: inside the process, or on an interface of the kernel."""

from __future__ import annotations

import os
from typing import Protocol

import can
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, open_python_can


class Bus(Protocol):
    """A bus that any number of stations of the test may join."""

    def open_link(self) -> Link: ...

    def open_python_can(self) -> can.BusABC: ...


class KernelBus:
    """The interface that HILBENCH_VCAN names."""

    def __init__(self) -> None:
        self.address = BusAddress("socketcan", os.environ["HILBENCH_VCAN"])

    def open_link(self) -> Link:
        return open_link(self.address)

    def open_python_can(self) -> can.BusABC:
        return open_python_can(self.address)
