"""Compiled cycle of a tension loop: decides if it may be closed on the twin, then the controller's velocity, and
the damping of the swing.

It runs in stages: on a rare event (the loop opens or closes, the damping's gains follow another E) it returns,
the interpreter does its part, and calls it again from the next stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.swing_damping import damp, has_changed
from hilbench.bench.tasks.tension_control import control
from hilbench.bench.tasks.tension_trust import REPORTED, TRUSTED, judged
from hilbench.bench.tasks.web_strain_trajectory import (
    entering_strain,
    shown_m_s,
    trajectory_tension_N,
    trajectory_velocity,
)
from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, compiled, entry_point, floats, integers
from hilbench.cycle_program import CONTINUE

Table = NDArray[np.int64]
Vector = NDArray[np.float64]
Places = NDArray[np.int64]

#: Where a cycle begins, and behind what is to be decided.
JUDGE, CONTROL = range(2)
#: Events for the interpreter: the twin's data are of before it was lost; its trust has changed; E differs from
#: that of the damping's gains. Below them the findings of `judged`.
STALE, CHANGED, OTHER_MODULUS = range(16, 19)
# Rows of the table.
(
    _CONTROLLER,
    _CONTROLLED,
    _PLANT,
    _GAINS,
    _PAIRED,
    _DAMPED_STATE,
    _POSITIONS,
    _LOOP,
    _LEADER,
    _VALUES,
    _WORDS,
    _AT,
    _TRUST,
    _TRUST_STATE,
    _TRUST_AT,
    _TRAJECTORY,
    _ENTERING,
    _ENTERING_AT,
    _LEADS,
) = range(19)
#: Of a loop: set-point, what a probe shifts it by, E as it was known last; what the axis is to turn at without and with
#: the damping; the cycle whose twin data the controller has had, -1: none; whether it is closed, NEVER: it was not yet;
#: whether the twin's data are of now; a cycle, s; positions of the axes before and behind the span where no signal
#: shows them; what a movement at rest adds to the velocity, nan: there is none.
SET_POINT_N, SHIFT_N, MODULUS_PA, SPEED_M_S, DAMPED_M_S, CONTROLLED_CYCLE, CLOSED, FRESH, CYCLE_S = range(9)
BEFORE_M, BEHIND_M, PULL_M_S, LOOP = range(9, 13)
NEVER = -1.0
#: Speeds of an axis that another one follows: without and with what is damped.
LEADS_BY, LEADS_DAMPED_BY, SPEEDS = range(3)
#: Places in a sample: whether the loop is closed, command, tension and E of the twin, positions (NOWHERE: in the loop),
#: age in cycles, number of the cycle.
_CLOSED_AT, _COMMAND_AT, _TENSION_AT, _MODULUS_AT, _BEFORE_AT, _BEHIND_AT, _AGE_AT, _CYCLE_AT = range(8)
NOWHERE = -1
#: Cycles of late data of the twin that the tension controller makes up for in one step.
_MOST_CYCLES_AT_ONCE = 10


@compiled
def _since_controlled_s(loop: Vector, words: Places, at: Places) -> float:
    """Time by which the twin's data have advanced since the controller's last step: 0 while they are repeated."""
    reported = words[at[_CYCLE_AT]] - words[at[_AGE_AT]]
    cycles = 1 if loop[CONTROLLED_CYCLE] == NEVER else reported - int(loop[CONTROLLED_CYCLE])
    loop[CONTROLLED_CYCLE] = reported
    return float(min(max(cycles, 0), _MOST_CYCLES_AT_ONCE) * loop[CYCLE_S])


@compiled
def _control(table: Table, loop: Vector, values: Vector, words: Places, at: Places) -> None:
    """Velocity of the axis from the last sample."""
    leader, trajectory = floats(table, _LEADER, (1,)), floats(table, _TRAJECTORY, (1,))
    closed = loop[CLOSED] == 1.0
    words[at[_CLOSED_AT]] = 1 if closed else 0
    since_s, set_point_N, around_m_s = (
        _since_controlled_s(loop, words, at),
        loop[SET_POINT_N] + loop[SHIFT_N],
        np.nan,
    )
    tension_N, modulus_Pa, planned_m_s, lead_m_s = 0.0, 0.0, 0.0, 0.0
    if closed:
        tension_N = values[at[_TENSION_AT]]
        modulus_Pa = loop[MODULUS_PA] = values[at[_MODULUS_AT]]
    else:
        since_s = loop[CYCLE_S]
    if len(trajectory) > 0:
        behind_m_s, entering = leader[LEADS_DAMPED_BY], floats(table, _ENTERING, (1,))
        strain = entering_strain(
            entering, integers(table, _ENTERING_AT, (1,)), values, behind_m_s >= 0.0, loop[FRESH] != 0.0
        )
        set_point_N = trajectory_tension_N(trajectory, loop[MODULUS_PA])
        around_m_s, planned_m_s = trajectory_velocity(trajectory, behind_m_s, strain), shown_m_s(trajectory)
        lead_m_s = floats(table, _LEADS, (1,))[0]
    loop[SPEED_M_S] = control(
        floats(table, _CONTROLLER, (1,)),
        floats(table, _CONTROLLED, (1,)),
        closed,
        leader[LEADS_BY],
        set_point_N,
        tension_N,
        modulus_Pa,
        since_s,
        around_m_s,
    )
    positions_m, gains = floats(table, _POSITIONS, (1,)), floats(table, _GAINS, (1,))
    positions_m[0] = loop[BEFORE_M] if at[_BEFORE_AT] == NOWHERE else values[at[_BEFORE_AT]]
    positions_m[1] = loop[BEHIND_M] if at[_BEHIND_AT] == NOWHERE else values[at[_BEHIND_AT]]
    plant, coherence, s = floats(table, _PLANT, (1,)), floats(table, _PAIRED, (1,)), floats(table, _DAMPED_STATE, (1,))
    loop[DAMPED_M_S], pull_m_s = (
        loop[SPEED_M_S] + damp(plant, gains, coherence, s, positions_m, planned_m_s),
        loop[PULL_M_S],
    )
    if np.isnan(pull_m_s):
        values[at[_COMMAND_AT]] = loop[DAMPED_M_S] + lead_m_s
    else:  # what is damped would take the pull back
        loop[DAMPED_M_S] = loop[SPEED_M_S]
        values[at[_COMMAND_AT]] = loop[SPEED_M_S] + lead_m_s + pull_m_s


#: run(stage, table of `Vectors`): GOES_ON, or what is Python's.
@entry_point(COUNT, TABLE)
def run(stage: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    loop, values, words = floats(table, _LOOP, (1,)), floats(table, _VALUES, (1,)), integers(table, _WORDS, (1,))
    at = integers(table, _AT, (1,))
    if stage == JUDGE:
        if loop[FRESH] == 0.0:
            return STALE
        state = floats(table, _TRUST_STATE, (1,))
        found = judged(floats(table, _TRUST, (1,)), state, values, words, integers(table, _TRUST_AT, (1,)))
        if found != TRUSTED:
            return found
        if (state[REPORTED] != 0.0) != (loop[CLOSED] == 1.0):
            return CHANGED
        if loop[CLOSED] == 1.0 and has_changed(floats(table, _PLANT, (1,)), values[at[_MODULUS_AT]]):
            return OTHER_MODULUS
    _control(table, loop, values, words, at)
    return CONTINUE


def warm_up() -> None:
    """Compile, or load, before a cycle has to wait for it."""
    run(JUDGE, np.zeros((0, TABLE_WIDTH), np.int64))


def in_order(
    controller: Sequence[Vector],
    damping: Sequence[Vector],
    loop: Vector,
    leader: Vector,
    sample: tuple[Vector, Places, Places],
    trust: Sequence[NDArray[Any]],
    ahead: Sequence[NDArray[Any]] | None,
) -> tuple[NDArray[Any], ...]:
    """The vectors of the table: figures and state of `control`, those of `damp`, the loop, `SPEEDS` of the axis after
    the span, a sample as `reals` and `wholes` with the places in it, figures, state and places of `judged`; of a loop
    with a feed-forward `web_strain_trajectory`, the strain that enters with its places, and the axis' lead."""
    nothing = np.zeros(0)
    return (*controller, *damping, loop, leader, *sample, *trust, *(ahead or (nothing, nothing, nothing, nothing)))
