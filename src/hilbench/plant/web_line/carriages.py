"""Laws of carriages (dancers, accumulators), compiled.

A carriage is an axis after the rollers of its line: x is its position along its travel, positive where it lengthens the
web. With z(x) the length that it adds to each of its strands, z = x on a guide and R·sin(x/R) on an arm of length R:

    M·x'' = P - k·(x - x_rest) - b·x' - friction - z'(x)·(sum of the strands' tensions),      L_j' = z'(x)·x'
"""

from __future__ import annotations

from math import cos

from hilbench.compiled import inlined
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def is_carriage(k: int, i: int) -> bool:
    """True if axis i (from 0) of a line of k spans, with k + 1 rollers, is a carriage; without spans there are none."""
    return k > 0 and i > k


@inlined
def gain(p: Vector, axis: int, x_m: float) -> float:
    """Growth of a strand per travel, z'(x)."""
    arm = p[axis + lay.A_ARM_M]
    return cos(x_m / arm) if arm != 0.0 else 1.0


@inlined
def force_N(p: Vector, axis: int, x_m: float) -> float:
    """Force of cylinder, weight and spring, in the direction that lengthens the web."""
    return p[axis + lay.A_FORCE_N] - p[axis + lay.A_SPRING_N_PER_M] * (x_m - p[axis + lay.A_SPRING_REST_M])


@inlined
def web_force_N(p: Vector, w: Vector, axis: int, tension: int, x_m: float) -> float:
    """Force of its strands, whose tensions (K,) begin at offset `tension` of `w`."""
    total = 0.0
    for j in range(int(p[axis + lay.A_FIRST_SPAN]), int(p[axis + lay.A_LAST_SPAN]) + 1):
        total += w[tension + j]
    return -gain(p, axis, x_m) * total


@inlined
def add_length_rates(p: Vector, w: Vector, axis: int, length_rate: int, x_m: float, v_m_s: float) -> None:
    """Add the rates by its motion to those of the lengths (K,), m/s, from offset `length_rate` of `w` on."""
    rate = gain(p, axis, x_m) * v_m_s
    for j in range(int(p[axis + lay.A_FIRST_SPAN]), int(p[axis + lay.A_LAST_SPAN]) + 1):
        w[length_rate + j] += rate


@inlined
def beyond_m(p: Vector, axis: int, x_m: float) -> float:
    """Distance beyond the nearer of its stops; below 0 between them."""
    return max(x_m - p[axis + lay.A_UPPER_STOP_M], p[axis + lay.A_LOWER_STOP_M] - x_m)


@inlined
def side_of_stop(p: Vector, axis: int, x_m: float) -> float:
    """Side of the nearer of its stops: 1 the upper, -1 the lower."""
    return 1.0 if x_m - p[axis + lay.A_UPPER_STOP_M] > p[axis + lay.A_LOWER_STOP_M] - x_m else -1.0
