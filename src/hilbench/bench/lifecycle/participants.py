"""Places of the simulated hardware and the twin of a bench."""

from __future__ import annotations

from enum import Enum

from hilbench.errors import UnusableInputError
from hilbench.topology.config import BenchConfig


class Participants(Enum):
    """Place of the simulated hardware and the twin; the value is its name in messages."""

    STARTED = "started"  #: by the bench, as processes of their own
    PRESENT = "present"  #: by another program, on the bus already
    IN_PROCESS = "in process"  #: inside the bench's process (lockstep on the embedded bus; `bench.in_process`)


def can_be_in_process(config: BenchConfig) -> bool:
    """True if `check_in_process` finds nothing."""
    try:
        check_in_process(config)
    except UnusableInputError:
        return False
    return True


def check_in_process(config: BenchConfig) -> None:
    """Raise UnusableInputError for a config whose participants cannot live in the bench's process."""
    real = [part.name for part in config.parts if not part.is_ours]
    if config.bus_address.interface != "embedded":
        raise UnusableInputError("in-process", f"found bus {config.bus_address}, expected the embedded bus")
    if real:
        raise UnusableInputError("in-process", f"found {', '.join(real)} not simulated, expected all nodes simulated")
