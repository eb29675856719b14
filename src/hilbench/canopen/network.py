"""canopen's network with a short receive time-out, so that leaving it does not wait long for its thread."""

from __future__ import annotations

import canopen
from hilbench.can.python_can import can

#: How long its thread waits for a message at a time: by then it sees that it is to end. Leaving waits for half of it
#: on average, and a thread that receives nothing takes some 0.1 % of a core.
_RECEIVES_FOR_S = 0.02


class Network(canopen.Network):
    """Takes a bus over, and closes it with `disconnect`."""

    def __init__(self, bus: can.BusABC) -> None:
        super().__init__(bus)
        self.NOTIFIER_CYCLE = _RECEIVES_FOR_S
