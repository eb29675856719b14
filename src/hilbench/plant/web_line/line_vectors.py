"""Vectors of a simulated line, and state transfer into them; compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, INDICES, VECTOR, Reals, Vector, compiled, entry_point, inlined, merged
from hilbench.plant.web_line import kernel, laws, records
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.records import LineArrays


class LineVectors(NamedTuple):
    """Vectors of a `hilbench.plant.web_line.line.Line`, for compiled callers; described by `layout`, advanced by
    `kernel`."""

    p: Reals  #: parameters
    s: Reals  #: state
    u: Reals  #: inputs
    w: Reals  #: scratch space
    out: Reals  #: measured and true values now (`Layout.columns`)


@merged
def arrays(line: LineVectors) -> LineArrays:
    """Line of the kernel in these vectors."""
    return records.line_of(line.p, line.s, line.u, line.w)


@compiled
def put_strain(line: LineVectors, span: int, strain: float) -> None:
    """Set the strain of a span (from 0); its length stays. Call `show` after it."""
    of = arrays(line)
    material = lay.S_Y + 4 * of.n + span
    line.s[material] = line.s[material + of.k] * laws.length_factor(records.span(of, span)) / (1.0 + strain)


@compiled
def put_motion(line: LineVectors, axis: int, x_m: float, v_m_s: float) -> None:
    """Set position and speed of an axis (from 0) with its motor. Call `show` after it."""
    s, n, at = line.s, arrays(line).n, lay.S_Y + axis
    s[at] = s[at + 2 * n] = x_m
    s[at + n] = s[at + 3 * n] = v_m_s


@compiled
def show(line: LineVectors) -> None:
    """Update measured values after a change of the state; friction and gear contact follow the motion."""
    of = arrays(line)
    kernel.set_modes(of)
    kernel.observe(*line)


@inlined
def tension_N(line: LineVectors, span: int) -> float:
    """Tension of a span (from 0), as last observed."""
    return float(line.out[3 * arrays(line).m + span])


@compiled
def strain(line: LineVectors, span: int) -> float:
    """Strain of a span (from 0), as last observed."""
    of = arrays(line)
    return float(line.out[3 * of.m + of.k + span])


@inlined
def is_as_at(line: LineVectors, first: int, value_1: float, value_2: float, limit: float) -> bool:
    """True if two values from this one on, as last observed, are within a limit of these."""
    return bool(max(abs(value_1 - line.out[first]), abs(value_2 - line.out[first + 1])) <= limit)


@entry_point(VECTOR, VECTOR, INDICES, COUNT, VECTOR, allocates=False)
def torque_ripples(p: Vector, s: Vector, motors: NDArray[np.int64], samples: int, ripples_Nm: Vector) -> None:
    """Excess of the mean torque of the first N of these motors over the last `samples` drive sample times over the mean
    of its two ends, N·m, into `ripples_Nm` (N,)."""
    line, now = records.line_of(p, s, s, s), int(s[lay.S_COUNT])
    # Fours are added up in two parallel sums, as a vector unit does.
    inner, ends = 1.0 / samples, 0.5 / samples - 0.5
    fours = (samples + 1) // 4 * 4
    for row in range(len(ripples_Nm)):
        past, even, odd = records.past(line, motors[row]), 0.0, 0.0
        for back in range(samples + 1):
            weighted = (ends if back in (0, samples) else inner) * s[past + (now - samples + back) % lay.RING]
            if back >= fours or back % 2 == 0:
                even += weighted
            else:
                odd += weighted
            if back == fours - 1:
                even += odd
        ripples_Nm[row] = even
