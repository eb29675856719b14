"""The vectors of a line that is simulated, and what is transferred into its state from outside; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, INDICES, VECTOR, compiled, entry_point
from hilbench.plant.web_line import kernel, laws, places
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


class LineVectors(NamedTuple):
    """What a `hilbench.plant.web_line.line.Line` consists of, for compiled callers: `layout` has what stands where,
    `kernel` goes on with it."""

    p: Vector  #: parameters
    s: Vector  #: state
    u: Vector  #: inputs
    w: Vector  #: scratch space
    out: Vector  #: what is measured and true now (`Layout.columns`)


@compiled
def put_strain(line: LineVectors, span: int, strain: float) -> None:
    """Let the web in a span (from 0) be strained so; its length stays. `show` after it."""
    n, m, k = places.counts(line.p)
    material = lay.S_Y + 4 * n + span
    factor = laws.length_factor(line.p, places.first_span(n, m) + span * lay.SP_SIZE)
    line.s[material] = line.s[material + k] * factor / (1.0 + strain)


@compiled
def put_motion(line: LineVectors, axis: int, x_m: float, v_m_s: float) -> None:
    """Let an axis (from 0), its motor with it, be there and as fast. `show` after it."""
    n = int(line.p[lay.W_AXES])
    at = lay.S_Y + axis
    line.s[at] = x_m
    line.s[at + 2 * n] = x_m
    line.s[at + n] = v_m_s
    line.s[at + 3 * n] = v_m_s


@compiled
def show(line: LineVectors) -> None:
    """Bring what is measured up to a state that was changed: friction and gear contact fit the motion, too."""
    n = int(line.p[lay.W_AXES])
    modes = lay.S_Y + 4 * n + 2 * int(line.p[lay.W_SPANS])
    for axis in range(n):
        speed = line.s[lay.S_Y + n + axis]
        at = modes + axis * lay.SA_SIZE
        line.s[at + lay.SA_DIRECTION] = 1.0 if speed > 0.0 else (-1.0 if speed < 0.0 else speed)
        if not laws.has_gap(line.p, places.axis(axis)):
            line.s[at + lay.SA_CONTACT] = 0.0
            line.s[lay.S_Y + 3 * n + axis] = speed
    kernel.observe(line.p, line.s, line.u, line.w, line.out)


@compiled
def reports(line: LineVectors) -> bool:
    """Whether what drives report is more than their motion and torque, and may go with the strain."""
    n, m, k = places.counts(line.p)
    return bool(line.w[places.part(n, m, k, lay.REPORTS)] != 0.0)


@compiled
def strain(line: LineVectors, span: int) -> float:
    """Of a span (from 0), as it was shown last."""
    m, k = int(line.p[lay.W_MOTORS]), int(line.p[lay.W_SPANS])
    return float(line.out[3 * m + k + span])


@compiled
def tension_behind_N(line: LineVectors, span: int, F_next_N: float) -> float:
    """Behind a span (from 0): that of the next one, as it was shown last; behind the last one `F_next_N`."""
    m, k = int(line.p[lay.W_MOTORS]), int(line.p[lay.W_SPANS])
    return float(line.out[3 * m + span + 1] if span + 1 < k else F_next_N)


@compiled
def is_near(line: LineVectors, axis: int, x1_m: float, x2_m: float, limit_m: float) -> bool:
    """Whether two axes (the first from 0), as they were shown last, are so near to these positions."""
    apart_1_m, apart_2_m = abs(x1_m - line.out[axis]), abs(x2_m - line.out[axis + 1])
    return bool(max(apart_1_m, apart_2_m) <= limit_m)


@compiled
def is_as_fast(line: LineVectors, axis: int, v1_m_s: float, v2_m_s: float, limit_m_s: float) -> bool:
    """The same of their speeds."""
    first = int(line.p[lay.W_MOTORS]) + axis
    apart_1_m_s, apart_2_m_s = abs(v1_m_s - line.out[first]), abs(v2_m_s - line.out[first + 1])
    return bool(max(apart_1_m_s, apart_2_m_s) <= limit_m_s)


@compiled
def put_torque_ripples(p: Vector, s: Vector, motors: NDArray[np.int64], samples: int, ripples_Nm: Vector) -> None:
    """By how much the torque of the first N of these motors was larger in the mean of the last `samples` sample times
    of the drives than in the mean of their begin and end, N·m, into `ripples_Nm` (N,)."""
    (n, m, k), now = places.counts(p), int(s[lay.S_COUNT])
    # Fours are added up in two sums beside each other, as a vector unit does.
    inner, ends = 1.0 / samples, 0.5 / samples - 0.5
    fours = (samples + 1) // 4 * 4
    for row in range(len(ripples_Nm)):
        past, even, odd = places.past(n, m, k, motors[row]), 0.0, 0.0
        for back in range(samples + 1):
            weighted = (ends if back in (0, samples) else inner) * s[past + (now - samples + back) % lay.RING]
            if back >= fours or back % 2 == 0:
                even += weighted
            else:
                odd += weighted
            if back == fours - 1:
                even += odd
        ripples_Nm[row] = even


@entry_point(VECTOR, VECTOR, INDICES, COUNT, VECTOR)
def torque_ripples(p: Vector, s: Vector, motors: NDArray[np.int64], samples: int, ripples_Nm: Vector) -> None:
    put_torque_ripples(p, s, motors, samples, ripples_Nm)
