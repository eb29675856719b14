"""Compiled cycle of a tension loop: decides if it may be closed on the twin, then the controller's velocity, and
the damping of the swing.

It runs in stages: on a rare event (the loop opens or closes) it returns, the interpreter does its part, and calls it
again from the next stage.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.tension_trust import REPORTED, TRUSTED, judged
from hilbench.bench.tasks.web_entering_strain import entering_strain
from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, Vector, compiled, entry_point, floats, integers, viewed
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, velocity_before, wanted_tension_N
from hilbench.control.web_line.swing_damping import damp_measured, follow_modulus
from hilbench.control.web_line.tension import CONTROLLER, control
from hilbench.cycle_program import CONTINUE

Table = NDArray[np.int64]
Places = NDArray[np.int64]

#: Where a cycle begins, and behind what is to be decided.
JUDGE, CONTROL = range(2)
#: Events for the interpreter: the twin's data are of before it was lost; its trust has changed. Below them the findings
#: of `judged`.
STALE, CHANGED = range(16, 18)
# Rows of the table.
(
    _CONTROLLER,
    _DAMPING,
    _COHERENCE,
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
) = range(16)
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
    leader, of_trajectory = floats(table, _LEADER, (1,)), floats(table, _TRAJECTORY, (1,))
    damping = floats(table, _DAMPING, (1,))
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
        follow_modulus(damping, modulus_Pa)
    else:
        since_s = loop[CYCLE_S]
    if len(of_trajectory) > 0:
        trajectory = viewed(of_trajectory, TRAJECTORY)[0]
        behind_m_s, entering = leader[LEADS_DAMPED_BY], floats(table, _ENTERING, (1,))
        strain = entering_strain(
            entering, integers(table, _ENTERING_AT, (1,)), values, behind_m_s >= 0.0, loop[FRESH] != 0.0
        )
        set_point_N = wanted_tension_N(trajectory, loop[MODULUS_PA])
        around_m_s, planned_m_s = velocity_before(trajectory, behind_m_s, strain), trajectory.shown_m_s
        lead_m_s = floats(table, _LEADS, (1,))[0]
    loop[SPEED_M_S] = control(
        viewed(floats(table, _CONTROLLER, (1,)), CONTROLLER)[0],
        closed,
        leader[LEADS_BY],
        set_point_N,
        tension_N,
        modulus_Pa,
        since_s,
        around_m_s,
    )
    positions_m, coherence = floats(table, _POSITIONS, (1,)), floats(table, _COHERENCE, (1,))
    positions_m[0] = loop[BEFORE_M] if at[_BEFORE_AT] == NOWHERE else values[at[_BEFORE_AT]]
    positions_m[1] = loop[BEHIND_M] if at[_BEHIND_AT] == NOWHERE else values[at[_BEHIND_AT]]
    loop[DAMPED_M_S] = loop[SPEED_M_S] + damp_measured(damping, coherence, positions_m, planned_m_s)
    pull_m_s = loop[PULL_M_S]
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
    _control(table, loop, values, words, at)
    return CONTINUE


def warm_up() -> None:
    """Compile, or load, before a cycle has to wait for it."""
    run(JUDGE, np.zeros((0, TABLE_WIDTH), np.int64))


def in_order(
    controller: Vector,
    damping: Sequence[Vector],
    loop: Vector,
    leader: Vector,
    sample: tuple[Vector, Places, Places],
    trust: Sequence[NDArray[Any]],
    ahead: Sequence[NDArray[Any]] | None,
) -> tuple[NDArray[Any], ...]:
    """The vectors of the table: `CONTROLLER`, those of `damp_measured`, the loop, `SPEEDS` of the axis after
    the span, a sample as `reals` and `wholes` with the places in it, figures, state and places of `judged`; of a loop
    with a feed-forward `TRAJECTORY`, the strain that enters with its places, and the axis' lead."""
    nothing = np.zeros(0)
    return (controller, *damping, loop, leader, *sample, *trust, *(ahead or (nothing, nothing, nothing, nothing)))
