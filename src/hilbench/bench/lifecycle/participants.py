"""Where the simulated hardware and the twin of a bench are."""

from __future__ import annotations

from enum import Enum


class Participants(Enum):
    """Who brings the simulated hardware and the twin; the value is how a message names it."""

    STARTED = "started"  #: by the bench, as processes of their own
    PRESENT = "present"  #: by somebody else, on the bus already
    IN_PROCESS = "in process"  #: inside the bench's process (lockstep on the embedded bus; `bench.in_process`)
