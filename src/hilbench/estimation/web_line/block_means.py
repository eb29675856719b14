"""The balance of a span in blocks: its means over 20 ms, from which every change of web or torque is seen.

What the roller's motion takes of the force is subtracted by the speeds at the block's ends. Single cycles that are
missing do no harm: a block goes on over them, as long as it is mostly measured. Compiled.
"""

from __future__ import annotations

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation.bank import Array

#: Length of a block: short against the way of the strain to a new value, and against what a stop takes.
BLOCK_S = 0.02
#: Change of the speed, relative, from which on blocks are not of one motion.
SAME_SPEED = 0.02
#: So many times as long it may last with the cycles that are missing in it.
_LONGEST = 3.0
#: Speeds at either end, of which the middle one counts: of a position that is of another instant one is too fast, and
#: the next too slow.
ENDS = 3

# State. The block that is collected: its first and last speeds (m/s) and the cycles that they are of; the last one that
# was complete, which is there for the cycle that completed it.
(
    _MASS_KG,
    _CYCLE_S,
    _CYCLES,
    _COLLECTED,
    _LASTED,  # cycles, with those that are missing
    _FORCE_SUM_N,
    _WEB_SUM,
    _AFTER_GAP,
    READY,
    FORCE_N,  # without what accelerates the roller
    WEB_PER_PA,
    VELOCITY_M_S,
    DURATION_S,
    MOTION_N,  # the largest of what accelerates the roller and of how far the force goes within the block
    _LOW_N,
    _HIGH_N,
    _FIRST,
) = range(17)
_FIRST_AT, _LAST, _LAST_AT = _FIRST + ENDS, _FIRST + 2 * ENDS, _FIRST + 3 * ENDS
_SIZE = _FIRST + 4 * ENDS


@compiled
def begin(s: Array) -> None:
    """Forget what is collected: a new block begins with the next cycle."""
    s[_COLLECTED] = 0.0
    s[_LASTED] = 0.0
    s[_FORCE_SUM_N] = 0.0
    s[_WEB_SUM] = 0.0
    s[READY] = 0.0


@compiled
def begin_behind_gap(s: Array) -> None:
    """The same, where the next cycle can't be compared with this one: it counts in the block's duration alone."""
    begin(s)
    s[_AFTER_GAP] = 1.0


@compiled
def miss(s: Array) -> None:
    """A cycle is missing: what is measured next is not one cycle after the last."""
    s[_LASTED] += 1.0
    s[_AFTER_GAP] = 1.0
    s[READY] = 0.0


@compiled
def take(s: Array, force_N: float, web_per_Pa: float, velocity_m_s: float) -> bool:
    """Take the balance of this cycle; whether a block is complete: READY is 1 then, and its means are in the state."""
    s[READY] = 0.0
    s[_LASTED] += 1.0
    if s[_AFTER_GAP] != 0.0:
        s[_AFTER_GAP] = 0.0
        return False
    if s[_LASTED] > _LONGEST * s[_CYCLES]:
        begin(s)
        s[_LASTED] = 1.0
    collected = int(s[_COLLECTED])
    if collected < ENDS:
        s[_FIRST + collected] = velocity_m_s
        s[_FIRST_AT + collected] = s[_LASTED]
    for i in range(ENDS - 1):
        s[_LAST + i] = s[_LAST + i + 1]
        s[_LAST_AT + i] = s[_LAST_AT + i + 1]
    s[_LAST + ENDS - 1] = velocity_m_s
    s[_LAST_AT + ENDS - 1] = s[_LASTED]
    s[_LOW_N] = min(s[_LOW_N], force_N) if collected > 0 else force_N
    s[_HIGH_N] = max(s[_HIGH_N], force_N) if collected > 0 else force_N
    s[_FORCE_SUM_N] += force_N
    s[_WEB_SUM] += web_per_Pa
    s[_COLLECTED] += 1.0
    if s[_COLLECTED] < s[_CYCLES]:
        return False
    _complete(s, velocity_m_s)
    return True


@inlined
def _complete(s: Array, velocity_m_s: float) -> None:
    count = s[_COLLECTED]
    if count > ENDS:
        gained_m_s = _middle(s, _LAST) - _middle(s, _FIRST)
        cycles = s[_LAST_AT + 1] - s[_FIRST_AT + 1]
    else:
        gained_m_s = velocity_m_s - s[_FIRST]
        cycles = s[_LAST_AT + ENDS - 1] - s[_FIRST_AT]
    accelerates_N = s[_MASS_KG] * gained_m_s / (cycles * s[_CYCLE_S])
    s[FORCE_N] = s[_FORCE_SUM_N] / count - accelerates_N
    s[MOTION_N] = max(abs(accelerates_N), s[_HIGH_N] - s[_LOW_N])
    s[WEB_PER_PA] = s[_WEB_SUM] / count
    s[VELOCITY_M_S] = velocity_m_s
    s[DURATION_S] = s[_LASTED] * s[_CYCLE_S]
    begin(s)
    s[READY] = 1.0


@inlined
def _middle(s: Array, at: int) -> float:
    a, b, c = s[at], s[at + 1], s[at + 2]
    return float(max(min(a, b), min(max(a, b), c)))


def new_state(mass_kg: float, cycle_s: float) -> Array:
    """State of what collects the balances of axis 2. `mass_kg`: at the web, of what is behind the span."""
    s = np.zeros(_SIZE)
    s[_MASS_KG], s[_CYCLE_S] = mass_kg, cycle_s
    cycles = max(2, round(BLOCK_S / cycle_s))
    # Where the middle ones of the speeds count these have to be apart: an acceleration over one cycle is mostly noise.
    s[_CYCLES] = max(cycles, 2 * ENDS) if cycles > ENDS else cycles
    return s
