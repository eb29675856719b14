"""Compiled cycle of a web emulated by load motors: time to follow, the web there, load torques of the predicted web,
and true values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, entry_point, floats, integers
from hilbench.plant.measured_motion import ahead_s, elapsed_s, publish, take
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import span_kernel

Table = NDArray[np.int64]
Places = NDArray[np.int64]
Vector = NDArray[np.float64]

# Rows of the table: those of a `SpanFollower`, whose `pull` torques are the last, those of the measured motion, then
# the process image's values and the offsets in it.
(
    _P,
    _STATE,
    _AHEAD,
    _WORK,
    _SPEEDS,
    _BOUNDARY,
    _TENSION,
    _TENSION_AHEAD,
    _LOADS,
    _TORQUES,
    _SHOWN,
    _MOTION,
    _TRAVELS,
    _POSITIONS,
    _MEASURED_SPEEDS,
    _VALUES,
    _AT,
) = range(17)


#: Results of `follow`: nothing to follow; followed; followed, with pieces of other web.
NOTHING, FOLLOWED, WITH_PIECES = range(3)


#: follow(late-sample flag, table of the vectors in the order of these rows, the last are values and offsets in these):
#: as of `measured_motion.InStep`.
@entry_point(COUNT, TABLE)
def follow(late: int, table: Table) -> int:
    if len(table) == 0:
        return NOTHING
    values, at = floats(table, _VALUES, (1,)), integers(table, _AT, (1,))
    motion, travels, x = floats(table, _MOTION, (1,)), floats(table, _TRAVELS, (1,)), floats(table, _POSITIONS, (1,))
    speeds = floats(table, _MEASURED_SPEEDS, (1,))
    take(values, at, x, speeds)
    duration_s = elapsed_s(motion, travels, x, speeds, late != 0)
    if not duration_s > 0.0:
        return NOTHING
    p, s, w = floats(table, _P, (1,)), floats(table, _STATE, (1,)), floats(table, _WORK, (1,))
    v, boundary, tension = (
        floats(table, _SPEEDS, (1,)),
        floats(table, _BOUNDARY, (1,)),
        floats(table, _TENSION, (1,)),
    )
    span_kernel.follow(p, s, w, v, boundary, x, duration_s, tension)
    ahead, tension_ahead = floats(table, _AHEAD, (1,)), floats(table, _TENSION_AHEAD, (1,))
    loads, torques = floats(table, _LOADS, (1, 2)), floats(table, _TORQUES, (1,))
    span_kernel.pull(p, s, ahead, w, v, boundary, ahead_s(motion), tension_ahead, loads, speeds, torques)
    shown = floats(table, _SHOWN, (1,))
    span_kernel.show(p, s, v, tension, shown)
    publish(values, at[2 * len(x) :], torques, shown)
    return WITH_PIECES if s[len(s) - lay.PIECES_SIZE + lay.PIECES_COUNT] > 0.0 else FOLLOWED
