"""Vectors of a simulated line, and state transfer into them; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, INDICES, VECTOR, Reals, compiled, entry_point
from hilbench.plant.web_line import kernel, laws, places
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


class LineVectors(NamedTuple):
    """Vectors of a `hilbench.plant.web_line.line.Line`, for compiled callers; described by `layout`, advanced by
    `kernel`."""

    p: Reals  #: parameters
    s: Reals  #: state
    u: Reals  #: inputs
    w: Reals  #: scratch space
    out: Reals  #: measured and true values now (`Layout.columns`)


@compiled
def put_strain(line: LineVectors, span: int, strain: float) -> None:
    """Set the strain of a span (from 0); its length stays. Call `show` after it."""
    n, m, k = places.counts(line.p)
    material = lay.S_Y + 4 * n + span
    factor = laws.length_factor(line.p, places.first_span(n, m) + span * lay.SP_SIZE)
    line.s[material] = line.s[material + k] * factor / (1.0 + strain)


@compiled
def put_motion(line: LineVectors, axis: int, x_m: float, v_m_s: float) -> None:
    """Set position and speed of an axis (from 0) with its motor. Call `show` after it."""
    n = int(line.p[lay.W_AXES])
    at = lay.S_Y + axis
    line.s[at] = x_m
    line.s[at + 2 * n] = x_m
    line.s[at + n] = v_m_s
    line.s[at + 3 * n] = v_m_s


@compiled
def show(line: LineVectors) -> None:
    """Update measured values after a change of the state; friction and gear contact follow the motion."""
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
    """True if drives report other values than their motion and torque, possibly depending on the strain."""
    n, m, k = places.counts(line.p)
    return bool(line.w[places.part(n, m, k, lay.REPORTS)] != 0.0)


@compiled
def strain(line: LineVectors, span: int) -> float:
    """Strain of a span (from 0), as last observed."""
    m, k = int(line.p[lay.W_MOTORS]), int(line.p[lay.W_SPANS])
    return float(line.out[3 * m + k + span])


@compiled
def tension_behind_N(line: LineVectors, span: int, F_next_N: float) -> float:
    """Tension after a span (from 0): that of the next one, as last observed; after the last one `F_next_N`."""
    m, k = int(line.p[lay.W_MOTORS]), int(line.p[lay.W_SPANS])
    return float(line.out[3 * m + span + 1] if span + 1 < k else F_next_N)


@compiled
def is_near(line: LineVectors, axis: int, x1_m: float, x2_m: float, limit_m: float) -> bool:
    """True if two axes (the first from 0), as last observed, are within `limit_m` of these positions."""
    apart_1_m, apart_2_m = abs(x1_m - line.out[axis]), abs(x2_m - line.out[axis + 1])
    return bool(max(apart_1_m, apart_2_m) <= limit_m)


@compiled
def is_as_fast(line: LineVectors, axis: int, v1_m_s: float, v2_m_s: float, limit_m_s: float) -> bool:
    """True if their speeds are within `limit_m_s` of these."""
    first = int(line.p[lay.W_MOTORS]) + axis
    apart_1_m_s, apart_2_m_s = abs(v1_m_s - line.out[first]), abs(v2_m_s - line.out[first + 1])
    return bool(max(apart_1_m_s, apart_2_m_s) <= limit_m_s)


@compiled
def put_torque_ripples(p: Vector, s: Vector, motors: NDArray[np.int64], samples: int, ripples_Nm: Vector) -> None:
    """Excess of the mean torque of the first N of these motors over the last `samples` drive sample times over the mean
    of its two ends, N·m, into `ripples_Nm` (N,)."""
    (n, m, k), now = places.counts(p), int(s[lay.S_COUNT])
    # Fours are added up in two parallel sums, as a vector unit does.
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
