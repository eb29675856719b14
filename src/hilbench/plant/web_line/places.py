"""Offsets of rows, states and scratch space of a line in the vectors of the kernel, compiled; see `layout`.

`n` axes, `m` motors and `k` spans; `i` an axis and `j` a motor, from 0.
"""

from __future__ import annotations

from hilbench.compiled import inlined
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Vector


@inlined
def axis(i: int) -> int:
    """Offset of axis row i in the parameters."""
    return lay.W_SIZE + i * lay.A_SIZE


@inlined
def motor(n: int, j: int) -> int:
    """Offset of motor row j in the parameters."""
    return lay.W_SIZE + n * lay.A_SIZE + j * lay.M_SIZE


@inlined
def first_span(n: int, m: int) -> int:
    """Offset of the span rows in the parameters."""
    return lay.W_SIZE + n * lay.A_SIZE + m * lay.M_SIZE


@inlined
def axis_state(n: int, k: int, i: int) -> int:
    """Offset of direction and contact of axis i in the state."""
    return lay.S_Y + 4 * n + 2 * k + i * lay.SA_SIZE


@inlined
def motor_state(n: int, k: int, j: int) -> int:
    """Offset of the state of motor j."""
    return lay.S_Y + 4 * n + 2 * k + n * lay.SA_SIZE + j * lay.SM_SIZE


@inlined
def past(n: int, m: int, k: int, j: int) -> int:
    """Offset of the past torques of motor j in the state."""
    return motor_state(n, k, m) + j * lay.RING


@inlined
def pieces(n: int, m: int, k: int) -> int:
    """Offset of the pieces of other web in the state."""
    return past(n, m, k, m)


@inlined
def block(n: int, k: int, b: int) -> int:
    """Offset of block b of integrated quantities in the scratch space."""
    return b * (4 * n + 2 * k)


@inlined
def part(n: int, m: int, k: int, part: int) -> int:
    """Offset of a part after the blocks in the scratch space."""
    return block(n, k, lay.BLOCKS) + part * m


@inlined
def counts(p: Vector) -> tuple[int, int, int]:
    """Axes, motors and spans of the line."""
    return int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(p[lay.W_SPANS])


@inlined
def has_counts(p: Vector, n: int, m: int, k: int) -> bool:
    """True for so many axes, motors and spans: lines most often simulated are compiled with constant offsets."""
    return p[lay.W_AXES] == n and p[lay.W_MOTORS] == m and p[lay.W_SPANS] == k
