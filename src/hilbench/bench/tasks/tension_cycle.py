"""Compiled cycle of a tension loop: decides if it may be closed on the twin, then the controller's velocity, and
the damping of the swing.

It runs in stages: on a rare event (the loop opens or closes) it returns, the interpreter does its part, and calls it
again from the next stage.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.tasks.tension_trust import TRUSTED, TrustArrays, judged
from hilbench.bench.tasks.web_entering_strain import ENTERING, ENTERING_AT, entering_strain
from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Wholes,
    Wholes2,
    arrays_in,
    compiled,
    entry_point,
    record_type,
    records,
)
from hilbench.control.web_line.strain_trajectory import TRAJECTORY, velocity_before, wanted_tension_N
from hilbench.control.web_line.swing_damping import damp_measured, follow_modulus
from hilbench.control.web_line.tension import CONTROLLER, control
from hilbench.cycle_program import CONTINUE

#: Where a cycle begins, and behind what is to be decided.
JUDGE, CONTROL = range(2)
#: Events for the interpreter: the twin's data are of before it was lost; its trust has changed. Below them the findings
#: of `judged`.
STALE, CHANGED = range(16, 18)
#: Of a loop: set-point, what a probe shifts it by, E as it was known last; the cycle whose twin data the controller has
#: had, -1: none; whether it is closed, NEVER: it was not yet; whether the twin's data are of now; a cycle; positions of
#: the axes before and behind the span where no signal shows them; what a movement at rest adds to the velocity, nan:
#: there is none.
LOOP = record_type(
    *("set_point_N", "shift_N", "modulus_Pa", "controlled_cycle", "closed", "fresh", "cycle_s"),
    *("before_m", "behind_m", "pull_m_s"),
)
NEVER = -1.0
#: Commanded web speeds of an axis, m/s, that another one follows: without and with what is damped.
SPEEDS = record_type("undamped", "damped")
#: Places in a sample: whether the loop is closed, command, tension and E of the twin, positions (NOWHERE: in the loop),
#: age in cycles, number of the cycle.
AT = record_type("closed", "command", "tension", "modulus", "before", "behind", "age", "cycle", of=np.int64)
NOWHERE = -1
#: Cycles of late data of the twin that the tension controller makes up for in one step.
_MOST_CYCLES_AT_ONCE = 10


class LoopArrays(NamedTuple):
    """What a loop works on: what `damp_measured` does, `SPEEDS` of its axis and of the axis after the span, a sample;
    with a feed-forward its trajectory (else none), the web that enters before and behind, and the axis' lead."""

    controller: Annotated[Any, CONTROLLER]
    damping: Reals
    coherence: Reals
    positions_m: Reals
    loop: Annotated[Any, LOOP]
    speeds: Annotated[Any, SPEEDS]
    leader: Annotated[Any, SPEEDS]
    values: Reals
    words: Wholes
    at: Annotated[Any, AT]
    trust: TrustArrays
    trajectory: Annotated[Any, records(TRAJECTORY)] = np.zeros(0, TRAJECTORY)
    entering: Annotated[Any, records(ENTERING)] = np.zeros(0, ENTERING)
    entering_at: Annotated[Any, records(ENTERING_AT)] = np.zeros(0, ENTERING_AT)
    leads_m_s: Reals = np.zeros(1)


@compiled
def _since_controlled_s(a: LoopArrays) -> float:
    """Time by which the twin's data have advanced since the controller's last step: 0 while they are repeated."""
    loop, reported = a.loop, a.words[a.at.cycle] - a.words[a.at.age]
    cycles = 1 if loop.controlled_cycle == NEVER else reported - int(loop.controlled_cycle)
    loop.controlled_cycle = reported
    return float(min(max(cycles, 0), _MOST_CYCLES_AT_ONCE) * loop.cycle_s)


@compiled
def _control(a: LoopArrays) -> None:
    """Velocity of the axis from the last sample."""
    loop, at, values = a.loop, a.at, a.values
    closed = loop.closed == 1.0
    a.words[at.closed] = 1 if closed else 0
    since_s, set_point_N, around_m_s = _since_controlled_s(a), loop.set_point_N + loop.shift_N, np.nan
    tension_N, modulus_Pa, planned_m_s, lead_m_s = 0.0, 0.0, 0.0, 0.0
    if closed:
        tension_N = values[at.tension]
        modulus_Pa = loop.modulus_Pa = values[at.modulus]
        follow_modulus(a.damping, modulus_Pa)
    else:
        since_s = loop.cycle_s
    if len(a.trajectory) > 0:
        trajectory, behind_m_s = a.trajectory[0], a.leader.damped
        side = 0 if behind_m_s >= 0.0 else 1
        strain = entering_strain(a.entering[side], a.entering_at[side], values, loop.fresh != 0.0)
        set_point_N = wanted_tension_N(trajectory, loop.modulus_Pa)
        around_m_s, planned_m_s = velocity_before(trajectory, behind_m_s, strain), trajectory.shown_m_s
        lead_m_s = a.leads_m_s[0]
    a.speeds.undamped = control(
        a.controller, closed, a.leader.undamped, set_point_N, tension_N, modulus_Pa, since_s, around_m_s
    )
    a.positions_m[0] = loop.before_m if at.before == NOWHERE else values[at.before]
    a.positions_m[1] = loop.behind_m if at.behind == NOWHERE else values[at.behind]
    a.speeds.damped = a.speeds.undamped + damp_measured(a.damping, a.coherence, a.positions_m, planned_m_s)
    pull_m_s = loop.pull_m_s
    if np.isnan(pull_m_s):
        values[at.command] = a.speeds.damped + lead_m_s
    else:  # what is damped would take the pull back
        a.speeds.damped = a.speeds.undamped
        values[at.command] = a.speeds.undamped + lead_m_s + pull_m_s


#: run(stage, table of `LoopArrays`): CONTINUE, or what is Python's.
@entry_point(COUNT, TABLE)
def run(stage: int, table: Wholes2) -> int:
    a = arrays_in(table, LoopArrays)
    if stage == JUDGE:
        if a.loop.fresh == 0.0:
            return STALE
        found = judged(a.trust, a.values, a.words)
        if found != TRUSTED:
            return found
        if (a.trust.state.reported != 0.0) != (a.loop.closed == 1.0):
            return CHANGED
    _control(a)
    return CONTINUE
