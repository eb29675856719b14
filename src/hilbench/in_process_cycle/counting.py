"""Counters of fast-path cycles, compiled, so that many can run in one call: time, frames, bits, the text of
the trace, heartbeats received, the twin's status."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, entry_point, floats, integers, viewed
from hilbench.cycle_program import CONTINUE
from hilbench.exchange.measured import BITS, CYCLES, TWIN_STATUS, TWIN_SYNC
from hilbench.fast_path import layout as lay

Table = NDArray[np.int64]

# Rows of the table of `count`: `given`, `left`, `frames` and `whole` of `fast_path.kernel.Vectors`, counters of
# `measured`, then its own: `totals`, by frame the cycle in which it was there last, place of the twin's status.
_GIVEN, _LEFT, _FRAMES, _WHOLE, _COUNTED, _TOTALS, _RECEIVED, _STATUS = range(8)
#: Totals: fast-path cycles, their frames, bits, and time on the wire in ns; the cycle of the twin's last status.
RUN, FRAMES, BITS_OF_ALL, DURATION_NS, REPORTED, TOTALS = range(6)
#: Of the status: its frame, and where it begins among the whole numbers.
_ROW, _FIRST = range(2)
#: What `said_alive` returns where the bench has.
VIRTUAL_IO = 1
_FRAME = lay.FRAME
_START_NS, _CLOCKS, _I_TEXT = lay.I_START_NS, lay.I_CLOCKS, lay.I_TEXT
_O_FRAMES, _O_BITS, _O_DURATION_NS, _O_TEXT = lay.O_FRAMES, lay.O_BITS, lay.O_DURATION_NS, lay.O_TEXT
_O_TIMED, _O_SIZE, _BY_TIME = lay.O_TIMED, lay.O_SIZE, lay.BY_TIME


#: count(length of a cycle in ns, table): count a fast-path cycle.
#: said_alive(row of the bench's heartbeat, table): SAID where that was on the wire.
#: ask(0, table of a sample, set points and their factors, pairs of a place in these and in the sample,
#: slots of real numbers, such pairs of them): send the outputs in a sample with the next SYNC.
@entry_point(COUNT, TABLE)
def count(cycle_ns: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    given, left, counted = (
        integers(table, _GIVEN, (1,)),
        integers(table, _LEFT, (1,)),
        integers(table, _COUNTED, (1,)),
    )
    totals, received, status = (
        integers(table, _TOTALS, (1,)),
        integers(table, _RECEIVED, (1,)),
        integers(table, _STATUS, (1,)),
    )
    given[_START_NS] += cycle_ns
    given[_CLOCKS] += cycle_ns
    given[_CLOCKS + 1] += cycle_ns
    given[_I_TEXT] = left[_O_TEXT]
    totals[RUN] += 1
    totals[FRAMES] += left[_O_FRAMES]
    totals[BITS_OF_ALL] += left[_O_BITS]
    totals[DURATION_NS] += left[_O_DURATION_NS]
    counted[CYCLES] += 1
    counted[BITS] = left[_O_BITS]
    if left[_O_SIZE + status[_ROW]] != 0:
        whole = integers(table, _WHOLE, (1,))
        counted[TWIN_SYNC], counted[TWIN_STATUS] = whole[status[_FIRST]], whole[status[_FIRST] + 2]
        totals[REPORTED] = totals[RUN]
    if left[_O_TIMED] != 0:
        frames = viewed(integers(table, _FRAMES, (1,)), _FRAME)
        for k in range(len(frames)):
            if frames[k].timing == _BY_TIME and left[_O_SIZE + k] != 0:
                received[k] = totals[RUN]
    return CONTINUE


@entry_point(COUNT, TABLE)
def heartbeat_sent(row: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    return VIRTUAL_IO if integers(table, _LEFT, (1,))[_O_SIZE + row] != 0 else CONTINUE


@entry_point(COUNT, TABLE)
def ask(_: int, table: Table) -> int:
    if len(table) == 0:
        return CONTINUE
    values, set_points, per_unit = floats(table, 0, (1,)), floats(table, 1, (1,)), floats(table, 2, (1,))
    places, real, inputs = integers(table, 3, (1,)), floats(table, 4, (1,)), integers(table, 5, (1,))
    for k in range(0, len(places), 2):
        set_points[places[k]] = values[places[k + 1]] * per_unit[k // 2]
    for k in range(0, len(inputs), 2):
        real[inputs[k]] = values[inputs[k + 1]]
    return CONTINUE


def warm_up() -> None:
    """Compile, or load from the cache, before a cycle has to wait for it."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    count(0, nothing)
    heartbeat_sent(0, nothing)
