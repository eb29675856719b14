"""Block means of a span's momentum balance over 20 ms, and six cycles at least, in which changes of web or
torque are detected.

The roller's inertial force is subtracted by the speeds at the block's ends. Single missing cycles do no harm: a block
goes on over them, as long as it is mostly measured. Compiled.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import Record, Vector, compiled, inlined, record_type

#: Length of a block: short against the strain's transition to a new value, and against a stop.
BLOCK_S = 0.02
#: Relative change of the speed from which on blocks belong to different motions.
SAME_SPEED = 0.02
#: Longest duration of a block with missing cycles, over its length.
_LONGEST = 3.0
#: Speeds at either end, of which the middle one counts: a position of another instant makes one too fast, and the next
#: too slow.
ENDS = 3

#: State of the block being collected: its cycles, with missing ones `lasted`; its first and last speeds (m/s) and their
#: cycles. Then the last complete block, valid in the cycle that completed it: force without the inertial force, and the
#: larger of that and the force's range within the block (`motion_N`).
BLOCK: Final = np.dtype(
    [
        *record_type(
            "mass_kg", "cycle_s", "cycles", "collected", "lasted", "force_sum_N", "web_sum", "after_gap"
        ).descr,
        *record_type("low_N", "high_N").descr,
        *[(name, "f8", (ENDS,)) for name in ("first_m_s", "first_at", "last_m_s", "last_at")],
        *record_type("ready", "force_N", "web_per_Pa", "velocity_m_s", "duration_s", "motion_N").descr,
    ]
)


@compiled
def begin(s: Record) -> None:
    """Discard the block being collected; the next cycle starts a new one."""
    s.collected = 0.0
    s.lasted = 0.0
    s.force_sum_N = 0.0
    s.web_sum = 0.0
    s.ready = 0.0


@compiled
def begin_behind_gap(s: Record) -> None:
    """Start a new block after a gap: the next cycle counts in its duration alone, as it is not comparable with this."""
    begin(s)
    s.after_gap = 1.0


@compiled
def miss(s: Record) -> None:
    """Count a missing cycle: the next sample is not one cycle after the last."""
    s.lasted += 1.0
    s.after_gap = 1.0
    s.ready = 0.0


@compiled
def take(s: Record, force_N: float, web_per_Pa: float, velocity_m_s: float) -> bool:
    """Take the balance of this cycle. True if a block is complete: READY is 1, and its means are in the state."""
    s.ready = 0.0
    s.lasted += 1.0
    if s.after_gap != 0.0:
        s.after_gap = 0.0
        return False
    if s.lasted > _LONGEST * s.cycles:
        begin(s)
        s.lasted = 1.0
    collected = int(s.collected)
    if collected < ENDS:
        s.first_m_s[collected] = velocity_m_s
        s.first_at[collected] = s.lasted
    for i in range(ENDS - 1):
        s.last_m_s[i] = s.last_m_s[i + 1]
        s.last_at[i] = s.last_at[i + 1]
    s.last_m_s[ENDS - 1] = velocity_m_s
    s.last_at[ENDS - 1] = s.lasted
    s.low_N = min(s.low_N, force_N) if collected > 0 else force_N
    s.high_N = max(s.high_N, force_N) if collected > 0 else force_N
    s.force_sum_N += force_N
    s.web_sum += web_per_Pa
    s.collected += 1.0
    if s.collected < s.cycles:
        return False
    count = s.collected
    if count > ENDS:
        gained_m_s = _middle(s.last_m_s) - _middle(s.first_m_s)
        cycles = s.last_at[1] - s.first_at[1]
    else:
        gained_m_s = velocity_m_s - s.first_m_s[0]
        cycles = s.last_at[ENDS - 1] - s.first_at[0]
    accelerates_N = s.mass_kg * gained_m_s / (cycles * s.cycle_s)
    s.force_N = s.force_sum_N / count - accelerates_N
    s.motion_N = max(abs(accelerates_N), s.high_N - s.low_N)
    s.web_per_Pa = s.web_sum / count
    s.velocity_m_s = velocity_m_s
    s.duration_s = s.lasted * s.cycle_s
    begin(s)
    s.ready = 1.0
    return True


@inlined
def _middle(values: Vector) -> float:
    a, b, c = values[0], values[1], values[2]
    return float(max(min(a, b), min(max(a, b), c)))


def new_state(mass_kg: float, cycle_s: float) -> NDArray[np.void]:
    """State of the block means of axis 2's balance. `mass_kg`: at the web, of the roller after the span."""
    s = np.zeros(1, BLOCK)
    s["mass_kg"], s["cycle_s"] = mass_kg, cycle_s
    # The middle speeds have to be apart: an acceleration over one cycle is mostly noise, and not that of the torques.
    s["cycles"] = max(round(BLOCK_S / cycle_s), 2 * ENDS)
    return s
