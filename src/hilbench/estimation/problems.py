"""EMCY error codes of a twin's measurements (CiA 301: FFxxh, device specific)."""

from __future__ import annotations

from enum import IntEnum

#: A torque shift (friction or torque offset), its N·m as REAL32 in the manufacturer's field; an undecided change of
#: torque: shift or E.
TORQUE_SHIFT, UNDECIDED = 0xFF17, 0xFF18


class Problem(IntEnum):
    """Reason why a measurement is not used. The value is the EMCY error code (CiA 301: FFxxh, device specific)."""

    INVALID = 0xFF10  #: not a number
    FROZEN = 0xFF11  #: the torque does not change any more
    SATURATED = 0xFF12  #: the drive is at its torque limit
    SLACK = 0xFF13  #: the web carries no tension
    STANDSTILL = 0xFF14  #: the roller is at rest under dry friction
    WEB_BREAK = 0xFF15  #: no web tension in spite of strain
    SLIP = 0xFF16  #: roller 2 slips: the encoders do not measure the web's strain


#: Problems by their numbers; 0: none.
PROBLEMS: dict[int, Problem | None] = {0: None} | {int(problem): problem for problem in Problem}
