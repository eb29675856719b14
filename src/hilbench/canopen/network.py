"""canopen's network, as the masters here use it: who leaves does not wait for its thread to look again."""

from __future__ import annotations

import canopen
from hilbench.can.letting_go import LetsGo
from hilbench.can.python_can import can

#: How long its thread waits for a message at a time: by then it sees that it is to end.
_RECEIVES_FOR_S = 0.1


class Network(canopen.Network):
    """Takes a bus over, and closes it with `disconnect`."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)
        self.NOTIFIER_CYCLE = _RECEIVES_FOR_S

    def disconnect(self) -> None:
        """Leave the bus; at once, where the bus can do that."""
        if isinstance(self.bus, LetsGo):
            self.bus.end_receiving()
        super().disconnect()
