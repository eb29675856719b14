"""Plausibility of a measurement for estimation; the problem is reported as EMCY, and as a bit of the twin's status."""

from __future__ import annotations

from math import isfinite
from typing import Final

import numpy as np

from hilbench.compiled import REAL, VECTOR, Record, Vector, compiled, entry_point, record_type, viewed
from hilbench.estimation.problems import PROBLEMS, Problem

#: Cycles with exactly the same torque after which a noisy measurement counts as frozen.
_FROZEN_CYCLES = 20
#: Share of the drive's limit from which on its torque counts as saturated, below which no longer, and time that it has
#: to stay there: noise crosses either, and a drive that has just left its limit soon returns to it.
_SATURATED, _FREE, _FREE_S = 0.995, 0.98, 0.05
#: Share of the upstream strain below which the web counts as slack: no tension, no information.
SLACK = 0.02
#: Speed below which a roller with dry friction is at rest: friction takes up the tension.
STANDSTILL_M_S = 1e-3


#: State: torque limit; cycles until it counts as free, and those left; speed below which the roller is at rest;
#: pull_per_Pa up to which the web is slack; last torque, and for how many cycles it has been the same.
PLAUSIBILITY: Final = record_type(
    *("limit_Nm", "free_cycles", "limited", "standstill_m_s", "slack_per_Pa", "last_Nm", "same", "has_changed")
)
_INVALID, _FROZEN, _SATURATED_NOW = int(Problem.INVALID), int(Problem.FROZEN), int(Problem.SATURATED)
_SLACK_NOW, _STANDING = int(Problem.SLACK), int(Problem.STANDSTILL)


@compiled
def find_problem(s: Record, torque_Nm: float, pull_per_Pa: float, velocity_m_s: float) -> int:
    """`Problem` of this cycle's torque; 0: none. s: state of a `Plausibility`."""
    if not (isfinite(torque_Nm) and isfinite(pull_per_Pa) and isfinite(velocity_m_s)):
        return _INVALID
    if torque_Nm == s.last_Nm:
        s.same += 1.0
    else:
        if isfinite(s.last_Nm):
            s.has_changed = 1.0
        s.same = 0.0
    s.last_Nm = torque_Nm
    size_Nm = abs(torque_Nm)
    if size_Nm >= _SATURATED * s.limit_Nm or (s.limited != 0.0 and size_Nm >= _FREE * s.limit_Nm):
        s.limited = s.free_cycles
    elif s.limited != 0.0:
        s.limited -= 1.0
    # A saturated torque repeats itself too.
    if s.limited > 0.0:
        return _SATURATED_NOW
    # A noiseless simulation at rest does as well, but it has not moved before.
    if s.same >= _FROZEN_CYCLES and s.has_changed != 0.0:
        return _FROZEN
    if pull_per_Pa <= s.slack_per_Pa:
        return _SLACK_NOW
    if abs(velocity_m_s) < s.standstill_m_s:
        return _STANDING
    return 0


@entry_point(VECTOR, REAL, REAL, REAL)
def _look(state: Vector, torque_Nm: float, pull_per_Pa: float, velocity_m_s: float) -> int:
    return find_problem(viewed(state, PLAUSIBILITY)[0], torque_Nm, pull_per_Pa, velocity_m_s)


class Plausibility:
    """Plausibility check of each cycle's measurement of axis 2; `torque_limit_Nm` and `dry_friction_N` of the model."""

    def __init__(self, torque_limit_Nm: float, dry_friction_N: float, slack_per_Pa: float, cycle_s: float) -> None:
        standstill_m_s = STANDSTILL_M_S if dry_friction_N > 0.0 else 0.0
        figures = torque_limit_Nm, round(_FREE_S / cycle_s), 0.0, standstill_m_s, SLACK * slack_per_Pa
        self.state = np.array([(*figures, np.nan, 0.0, 0.0)], PLAUSIBILITY)  #: for compiled callers

    def sticks(self, below_m_s: float) -> None:
        """Set a speed below which dry friction takes up the tension, whatever the model's friction."""
        self.state["standstill_m_s"] = below_m_s

    def problem(self, torque_Nm: float, pull_per_Pa: float, velocity_m_s: float) -> Problem | None:
        """Problem of this cycle's torque, if there is one."""
        return PROBLEMS[_look(self.state.view(np.float64), torque_Nm, pull_per_Pa, velocity_m_s)]
