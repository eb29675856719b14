"""The emergency stop on the bus: what is sent, by whomever, and how a listener knows it.

The first frame is the global fail-safe command of EN 50325-5 (COB-ID 001h, no data): but for NMT it wins every
arbitration, and a device that knows it stops at once. The NMT command ENTER PRE-OPERATIONAL to all nodes follows: a
drive that does not know the first frame leaves OPERATIONAL and does what its 6007h asks for, and its state can still
be read by SDO.
"""

from __future__ import annotations

from typing import Final

from hilbench.bus.frame import Frame

EMERGENCY_STOP_COB_ID: Final = 0x001

_NMT_COB_ID: Final = 0x000
_PRE_OPERATIONAL_ALL: Final = bytes((128, 0))

EMERGENCY_STOP: Final = (Frame(EMERGENCY_STOP_COB_ID, b""), Frame(_NMT_COB_ID, _PRE_OPERATIONAL_ALL))
