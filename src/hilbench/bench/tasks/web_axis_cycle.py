"""Velocities of the axes of a line that have no loop of their own, compiled."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.tasks.tension_cycle import SPEEDS
from hilbench.compiled import COUNT, TABLE, Reals, Wholes2, arrays_in, entry_point, inlined, record_type
from hilbench.cycle_program import CONTINUE

#: Standstill excitation added to a speed, m/s: of the leading axis and its followers; of one axis, nan: none.
EXCITATION = record_type("creep_m_s", "pull_m_s")


class LeadingArrays(NamedTuple):
    """What `lead` works on: the line speed (1,), standstill excitation, the axis' speeds, `reals` of a sample."""

    line_speed: Reals
    excitation: Annotated[Any, EXCITATION]
    speeds: Annotated[Any, SPEEDS]
    values: Reals


class FollowingArrays(NamedTuple):
    """What `follow` works on: speeds of the axis after it, lead of this one (1,), the rest as in `LeadingArrays`."""

    leader: Annotated[Any, SPEEDS]
    leads_m_s: Reals
    excitation: Annotated[Any, EXCITATION]
    speeds: Annotated[Any, SPEEDS]
    values: Reals


@inlined
def _with_pull(speed_m_s: float, pull_m_s: float) -> float:
    return speed_m_s if np.isnan(pull_m_s) else speed_m_s + pull_m_s


@entry_point(COUNT, TABLE)
def lead(command: int, table: Wholes2) -> int:
    """Run a cycle of the leading axis; `command`: place of its command in a sample."""
    a = arrays_in(table, LeadingArrays)
    a.speeds.undamped = a.speeds.damped = a.line_speed[0] + a.excitation.creep_m_s
    a.values[command] = _with_pull(a.speeds.undamped, a.excitation.pull_m_s)
    return CONTINUE


@entry_point(COUNT, TABLE)
def follow(command: int, table: Wholes2) -> int:
    """Run a cycle of an axis that follows another one; `command`: place of its command in a sample."""
    a = arrays_in(table, FollowingArrays)
    a.speeds.undamped, a.speeds.damped = a.leader.undamped, a.leader.damped
    a.values[command] = _with_pull(a.speeds.damped + a.leads_m_s[0], a.excitation.pull_m_s)
    return CONTINUE
