"""Whether a measurement can be used to find E; if not, why (reported as EMCY, and as a bit of the twin's status)."""

from __future__ import annotations

from enum import IntEnum
from math import isfinite

#: Cycles with exactly the same torque after which a noisy measurement counts as frozen.
_FROZEN_CYCLES = 20
#: Share of the drive's limit from which its torque counts as limited, below which no longer, and how long it has to
#: stay there: noise goes to and fro over either, and a drive that has just left its limit soon returns to it.
_SATURATED, _FREE, _FREE_S = 0.995, 0.98, 0.05
#: Share of the upstream strain below which the web counts as slack: no tension, nothing to learn.
_SLACK = 0.02
#: Speed below which a roller with dry friction stands: friction takes up the tension.
_STANDSTILL_M_S = 1e-3


class Problem(IntEnum):
    """Why a measurement is not used. The value is the EMCY error code (CiA 301: FFxxh, device specific)."""

    INVALID = 0xFF10  #: not a number
    FROZEN = 0xFF11  #: the torque does not change any more
    SATURATED = 0xFF12  #: the drive is at its torque limit
    SLACK = 0xFF13  #: the web carries no tension
    STANDSTILL = 0xFF14  #: the roller stands under dry friction
    WEB_BREAK = 0xFF15  #: the web does not pull any more although it should be strained
    SLIP = 0xFF16  #: roller 2 slips: the encoders do not show the web's strain


class Plausibility:
    """Looks at each cycle's measurement of axis 2; `torque_limit_Nm` and `dry_friction_N` as the model has them."""

    def __init__(self, torque_limit_Nm: float, dry_friction_N: float, slack_per_Pa: float, cycle_s: float) -> None:
        self._limit_Nm = torque_limit_Nm
        self._free_cycles = round(_FREE_S / cycle_s)
        self._limited = 0  #: cycles until the torque counts as free again
        self._dry_friction = dry_friction_N > 0.0
        self._slack_per_Pa = _SLACK * slack_per_Pa
        self._last_Nm = float("nan")
        self._same = 0
        self._has_changed = False

    def problem(self, torque_Nm: float, web_per_Pa: float, velocity_m_s: float) -> Problem | None:
        """What is wrong with this cycle's torque, if anything."""
        if not (isfinite(torque_Nm) and isfinite(web_per_Pa) and isfinite(velocity_m_s)):
            return Problem.INVALID
        if torque_Nm == self._last_Nm:
            self._same += 1
        else:
            self._has_changed = self._has_changed or isfinite(self._last_Nm)
            self._same = 0
        self._last_Nm = torque_Nm
        # A torque at its limit repeats itself too.
        if self._is_limited(abs(torque_Nm)):
            return Problem.SATURATED
        # A noiseless simulation at rest does as well, but it has not moved before.
        if self._same >= _FROZEN_CYCLES and self._has_changed:
            return Problem.FROZEN
        if web_per_Pa <= self._slack_per_Pa:
            return Problem.SLACK
        if self._dry_friction and abs(velocity_m_s) < _STANDSTILL_M_S:
            return Problem.STANDSTILL
        return None

    def _is_limited(self, size_Nm: float) -> bool:
        if size_Nm >= _SATURATED * self._limit_Nm or (self._limited and size_Nm >= _FREE * self._limit_Nm):
            self._limited = self._free_cycles
        elif self._limited:
            self._limited -= 1
        return self._limited > 0
