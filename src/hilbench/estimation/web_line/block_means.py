"""Block means of a span's momentum balance over 20 ms, and six cycles at least, in which changes of web or
torque are detected.

The roller's inertial force is subtracted by the speeds at the block's ends. Single missing cycles do no harm: a block
goes on over them, as long as it is mostly measured. Compiled.
"""

from __future__ import annotations

import numpy as np

from hilbench.compiled import compiled, inlined
from hilbench.estimation.bank import Array

#: Length of a block: short against the strain's transition to a new value, and against a stop.
BLOCK_S = 0.02
#: Relative change of the speed from which on blocks belong to different motions.
SAME_SPEED = 0.02
#: Longest duration of a block with missing cycles, over its length.
_LONGEST = 3.0
#: Speeds at either end, of which the middle one counts: a position of another instant makes one too fast, and the next
#: too slow.
ENDS = 3

# State. The block being collected: its first and last speeds (m/s) and their cycles; the last complete block, valid in
# the cycle that completed it.
(
    _MASS_KG,
    _CYCLE_S,
    _CYCLES,
    _COLLECTED,
    _LASTED,  # cycles, including missing ones
    _FORCE_SUM_N,
    _WEB_SUM,
    _AFTER_GAP,
    READY,
    FORCE_N,  # without the inertial force
    WEB_PER_PA,
    VELOCITY_M_S,
    DURATION_S,
    MOTION_N,  # larger of the inertial force and the force's range within the block
    _LOW_N,
    _HIGH_N,
    _FIRST,
) = range(17)
_FIRST_AT, _LAST, _LAST_AT = _FIRST + ENDS, _FIRST + 2 * ENDS, _FIRST + 3 * ENDS
_SIZE = _FIRST + 4 * ENDS


@compiled
def begin(s: Array) -> None:
    """Discard the block being collected; the next cycle starts a new one."""
    s[_COLLECTED] = 0.0
    s[_LASTED] = 0.0
    s[_FORCE_SUM_N] = 0.0
    s[_WEB_SUM] = 0.0
    s[READY] = 0.0


@compiled
def begin_behind_gap(s: Array) -> None:
    """Start a new block after a gap: the next cycle counts in its duration alone, as it is not comparable with this."""
    begin(s)
    s[_AFTER_GAP] = 1.0


@compiled
def miss(s: Array) -> None:
    """Count a missing cycle: the next sample is not one cycle after the last."""
    s[_LASTED] += 1.0
    s[_AFTER_GAP] = 1.0
    s[READY] = 0.0


@compiled
def take(s: Array, force_N: float, web_per_Pa: float, velocity_m_s: float) -> bool:
    """Take the balance of this cycle. True if a block is complete: READY is 1, and its means are in the state."""
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
    """State of the block means of axis 2's balance. `mass_kg`: at the web, of the roller after the span."""
    s = np.zeros(_SIZE)
    s[_MASS_KG], s[_CYCLE_S] = mass_kg, cycle_s
    # The middle speeds have to be apart: an acceleration over one cycle is mostly noise, and not that of the torques.
    s[_CYCLES] = max(round(BLOCK_S / cycle_s), 2 * ENDS)
    return s
