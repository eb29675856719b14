"""Compiled cycle of a line emulated by load motors: time to follow, the line there, load torques of the predicted line,
and true values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, compiled, entry_point, floats, integers
from hilbench.plant.measured_motion import ahead_s, elapsed_s, publish, take
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import line_kernel, places
from hilbench.plant.web_line.layout import Vector

Table = NDArray[np.int64]
Places = NDArray[np.int64]

# Rows of the table: those of `line_kernel.pull`, those of the measured motion, zero position offsets (N,), indices of
# the outputs in the kernel's report and in the integrated quantities, and rows of the reels; room for all outputs; then
# the process image's values and the offsets in it.
_MOTION, _TRAVELS, _POSITIONS, _FURTHER, _COLUMNS, _STATES, _REELS, _SHOWN, _VALUES, _AT = range(
    line_kernel.TORQUES + 1, line_kernel.TORQUES + 11
)

#: Results of `follow`.
NOTHING, FOLLOWED = range(2)


@compiled
def _show(
    p: Vector, s: Vector, u: Vector, out: Vector, columns: Places, states: Places, rows: Places, shown: Vector
) -> None:
    """Write the outputs in the order of the follower's description."""
    at = 0
    for j in range(len(columns)):
        shown[at] = out[columns[j]]
        at += 1
    for j in range(len(states)):
        shown[at] = s[lay.S_Y + states[j]]
        at += 1
    for j in range(len(rows)):
        shown[at] = p[places.axis(rows[j]) + lay.A_RADIUS_M] * line_kernel.ratio(p, s, rows[j])
        at += 1
    line_kernel.put_moduli(p, s, u, shown, at)


#: follow(late-sample flag, table of the vectors in the order of these rows, the last are values and offsets in these):
#: as of `measured_motion.InStep`.
@entry_point(COUNT, TABLE)
def follow(late: int, table: Table) -> int:
    if len(table) == 0:
        return NOTHING
    values, at = floats(table, _VALUES, (1,)), integers(table, _AT, (1,))
    motion, travels, x = floats(table, _MOTION, (1,)), floats(table, _TRAVELS, (1,)), floats(table, _POSITIONS, (1,))
    speeds = floats(table, line_kernel.SPEEDS, (1,))
    take(values, at, x, speeds)
    duration_s = elapsed_s(motion, travels, x, speeds, late != 0)
    if not duration_s > 0.0:
        return NOTHING
    line_kernel.follow_alone(table, x, floats(table, _FURTHER, (1,)), duration_s)
    p, s = floats(table, line_kernel.P, (1,)), floats(table, line_kernel.STATE, (1,))
    u, shown = floats(table, line_kernel.INPUTS, (1,)), floats(table, _SHOWN, (1,))
    _show(
        p, s, u, floats(table, line_kernel.OUT, (1,)), integers(table, _COLUMNS, (1,)),
        integers(table, _STATES, (1,)), integers(table, _REELS, (1,)), shown,
    )  # fmt: skip
    line_kernel.pull_alone(table, ahead_s(motion))
    publish(values, at[2 * len(x) :], floats(table, line_kernel.TORQUES, (1,)), shown)
    return FOLLOWED
