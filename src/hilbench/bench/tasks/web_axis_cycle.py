"""Velocities of the axes of a line that have no loop of their own, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.tension_cycle import LEADS_BY, LEADS_DAMPED_BY
from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, entry_point, floats, inlined
from hilbench.cycle_program import CONTINUE, Function

Table = NDArray[np.int64]

#: Standstill excitation added to a speed, m/s: of the leading axis and its followers; of one axis, nan: none.
CREEP_M_S, PULL_M_S = range(2)


def not_moved() -> NDArray[np.float64]:
    """Vector of an axis without standstill excitation."""
    return np.array([0.0, np.nan])


@inlined
def _with_pull(speed_m_s: float, pull_m_s: float) -> float:
    return speed_m_s if np.isnan(pull_m_s) else speed_m_s + pull_m_s


#: lead(place of the command in a sample, table of the line speed (1,), standstill excitation, `SPEEDS`, `reals`
#: of the sample): the leading axis.
#: follow(as above, table of the `SPEEDS` of the axis after it, lead of this one (1,), its own `SPEEDS`, `reals`,
#: its standstill excitation).
@entry_point(COUNT, TABLE)
def lead(command: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    line_speed, moved, speeds, values = (
        floats(table, 0, (1,)),
        floats(table, 1, (1,)),
        floats(table, 2, (1,)),
        floats(table, 3, (1,)),
    )
    speeds[LEADS_BY] = speeds[LEADS_DAMPED_BY] = line_speed[0] + moved[CREEP_M_S]
    values[command] = _with_pull(speeds[LEADS_BY], moved[PULL_M_S])
    return CONTINUE


@entry_point(COUNT, TABLE)
def follow(command: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    leader, leads_m_s, speeds, values, moved = (
        floats(table, 0, (1,)),
        floats(table, 1, (1,)),
        floats(table, 2, (1,)),
        floats(table, 3, (1,)),
        floats(table, 4, (1,)),
    )
    speeds[LEADS_BY], speeds[LEADS_DAMPED_BY] = leader[LEADS_BY], leader[LEADS_DAMPED_BY]
    values[command] = _with_pull(speeds[LEADS_DAMPED_BY] + leads_m_s[0], moved[PULL_M_S])
    return CONTINUE


def warm_up(function: Function) -> None:
    """Compile, or load, one of these, before a cycle has to wait for it."""
    function(0, np.zeros((0, TABLE_WIDTH), np.int64))
