"""Laws of carriages (dancers, accumulators), compiled.

A carriage is an axis after the rollers of its line: x is its position along its travel, positive where it lengthens the
web. With z(x) the length that it adds to each of its strands, z = x on a guide and R·sin(x/R) on an arm of length R:

    M·x'' = P - k·(x - x_rest) - b·x' - friction - z'(x)·(sum of the strands' tensions),      L_j' = z'(x)·x'
"""

from __future__ import annotations

from math import cos

from hilbench.compiled import Record, inlined
from hilbench.plant.web_line.records import LineArrays


@inlined
def is_carriage(line: LineArrays, i: int) -> bool:
    """True if axis i (from 0) of a line of k spans, with k + 1 rollers, is a carriage; without spans there are none."""
    return line.k > 0 and i > line.k


@inlined
def gain(axis: Record, x_m: float) -> float:
    """Growth of a strand per travel, z'(x)."""
    return cos(x_m / axis.arm_m) if axis.arm_m != 0.0 else 1.0


@inlined
def beyond_m(axis: Record, x_m: float) -> float:
    """Distance beyond the nearer of its stops; below 0 between them."""
    return max(x_m - axis.upper_stop_m, axis.lower_stop_m - x_m)
