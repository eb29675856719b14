"""Emergency stop on the bus: frames to send, and their detection by a listener.

The first frame is the global fail-safe command of EN 50325-5 (COB-ID 001h, no data): except for NMT it wins every
arbitration, and a device that knows it stops at once. The NMT command ENTER PRE-OPERATIONAL to all nodes follows: a
drive that does not know the first frame leaves OPERATIONAL and acts by its 6007h, and its state can still
be read by SDO.
"""

from __future__ import annotations

import time
from typing import Final

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.identifiers import NMT, NmtCommand
from hilbench.errors import BusError

EMERGENCY_STOP_COB_ID: Final = 0x001

EMERGENCY_STOP: Final = (
    Frame(EMERGENCY_STOP_COB_ID, b""),
    Frame(NMT, NmtCommand.ENTER_PRE_OPERATIONAL.to(0)),
)

#: The stop is sent so often: a frame can be lost.
_TIMES: Final = 3
_PAUSE_S: Final = 0.01


def send_emergency_stop(link: Link) -> None:
    """Stop everything on the bus; takes 30 ms. Raises BusError when it cannot be sent the last time either."""
    for attempt in range(_TIMES):
        try:
            link.send(EMERGENCY_STOP)
        except BusError:
            if attempt == _TIMES - 1:
                raise
        time.sleep(_PAUSE_S)
