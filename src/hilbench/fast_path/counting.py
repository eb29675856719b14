"""Stages of a bench's fast-path cycle around its exchange: outputs of a sample, counters, its heartbeat."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.compiled import COUNT, TABLE, Reals, Table, Wholes, arrays_in, entry_point, record_type, records
from hilbench.cycle_program import CONTINUE
from hilbench.exchange.measured import COUNTED
from hilbench.fast_path import layout as lay

#: Totals: fast-path cycles, their frames, bits, and time on the wire in ns; the cycle of the twin's last status.
TOTALS = record_type("cycles", "frames", "bits", "duration_ns", "reported", of=np.int64)
#: Of the twin's status: its frame, and its first slot.
STATUS = record_type("frame", "slot", of=np.int64)
#: An output: its place in a sample, and among the set points or the real numbers of the image.
OUTPUT = record_type("signal", "place", of=np.int64)
#: What `heartbeat_sent` returns where the bench has sent it.
SENT = 1
_BY_CYCLES = lay.BY_CYCLES


class Counting(NamedTuple):
    """The image of a cycle as far as it is counted, and counters; by frame the cycle in which it was there last."""

    frames: Annotated[Any, records(lay.FRAME)]
    given: Annotated[Any, lay.GIVEN]
    left: Annotated[Any, lay.LEFT]
    clocks: Wholes
    whole: Wholes
    counted: Annotated[Any, COUNTED]
    totals: Annotated[Any, TOTALS]
    received: Wholes
    status: Annotated[Any, STATUS]


class Outputs(NamedTuple):
    """Set points, with the factor of each output, and real numbers of the image, from the values of a sample."""

    values: Reals
    set_points: Reals
    targets: Annotated[Any, records(OUTPUT)]
    per_unit: Reals
    real: Reals
    inputs: Annotated[Any, records(OUTPUT)]


#: count(length of a cycle in ns, table of `Counting`): count a fast-path cycle.
#: heartbeat_sent(row of the bench's heartbeat, table of `Counting`): SENT where that was on the wire.
#: take_outputs(0, table of `Outputs`): send the outputs in a sample with the next SYNC.
@entry_point(COUNT, TABLE)
def count(cycle_ns: int, table: Table) -> int:
    a = arrays_in(table, Counting)
    given, left, totals, counted = a.given, a.left, a.totals, a.counted
    given.start_ns += cycle_ns
    given.text = left.text
    for k in range(len(a.clocks)):
        a.clocks[k] += cycle_ns
    totals.cycles += 1
    totals.frames += left.frames
    totals.bits += left.bits
    totals.duration_ns += left.duration_ns
    counted.cycles += 1
    counted.bits = left.bits
    if a.frames[a.status.frame].bits_on_wire != 0:
        counted.twin_sync, counted.twin_status = a.whole[a.status.slot], a.whole[a.status.slot + 2]
        totals.reported = totals.cycles
    if left.timed != 0:
        for k in range(len(a.frames)):
            if a.frames[k].timing != _BY_CYCLES and a.frames[k].bits_on_wire != 0:
                a.received[k] = totals.cycles
    return CONTINUE


@entry_point(COUNT, TABLE)
def heartbeat_sent(row: int, table: Table) -> int:
    return SENT if arrays_in(table, Counting).frames[row].bits_on_wire != 0 else CONTINUE


@entry_point(COUNT, TABLE)
def take_outputs(_: int, table: Table) -> int:
    a = arrays_in(table, Outputs)
    for k in range(len(a.targets)):
        a.set_points[a.targets[k].place] = a.values[a.targets[k].signal] * a.per_unit[k]
    for k in range(len(a.inputs)):
        a.real[a.inputs[k].place] = a.values[a.inputs[k].signal]
    return CONTINUE
