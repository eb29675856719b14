"""Records of a line in the vectors of the kernel, compiled; see `layout`. `i` an axis, `j` a motor or span, from 0.

What hands out arrays is merged: an entry point counts references, and would take over one that nobody gave to it.
"""

from __future__ import annotations

from typing import NamedTuple

from hilbench.compiled import Record, Vector, inlined, merged, record_in
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import (
    A_SIZE,
    AXIS,
    BOUNDARY,
    CALL,
    DRIVE,
    DRIVE_INPUT,
    M_SIZE,
    MODE,
    MOTOR,
    PART,
    SP_SIZE,
    SPAN,
    W_SIZE,
    WEB,
    WEB_PIECES,
)


class LineArrays(NamedTuple):
    """Vectors of a line, and its counts, which are constants where it is compiled for these."""

    p: Vector  #: parameters
    s: Vector  #: state
    u: Vector  #: inputs
    w: Vector  #: scratch space
    n: int  #: axes
    m: int  #: motors
    k: int  #: spans


@merged
def line_of(p: Vector, s: Vector, u: Vector, w: Vector) -> LineArrays:
    """Any line, with its counts of axes, motors and spans."""
    web = record_in(p, 0, WEB)
    return LineArrays(p, s, u, w, int(web.axes), int(web.motors), int(web.spans))


@merged
def of_parameters(p: Vector) -> LineArrays:
    """Parameters alone."""
    return line_of(p, p, p, p)


@inlined
def web(line: LineArrays) -> Record:
    """`WEB` of a line."""
    return record_in(line.p, 0, WEB)


@inlined
def axis(line: LineArrays, i: int) -> Record:
    """`AXIS` i."""
    return record_in(line.p, W_SIZE + i * A_SIZE, AXIS)


@inlined
def motor(line: LineArrays, j: int) -> Record:
    """`MOTOR` j."""
    return record_in(line.p, W_SIZE + line.n * A_SIZE + j * M_SIZE, MOTOR)


@inlined
def span(line: LineArrays, j: int) -> Record:
    """`SPAN` j."""
    return record_in(line.p, W_SIZE + line.n * A_SIZE + line.m * M_SIZE + j * SP_SIZE, SPAN)


@inlined
def mode(line: LineArrays, i: int) -> Record:
    """`MODE` of axis i."""
    return record_in(line.s, lay.S_Y + 4 * line.n + 2 * line.k + i * lay.MODE_SIZE, MODE)


@inlined
def drive(line: LineArrays, j: int) -> Record:
    """`DRIVE` of motor j."""
    first = lay.S_Y + (4 + lay.MODE_SIZE) * line.n + 2 * line.k
    return record_in(line.s, first + j * lay.DRIVE_SIZE, DRIVE)


@inlined
def past(line: LineArrays, j: int) -> int:
    """Offset of the past torques of motor j in the state."""
    return lay.S_Y + (4 + lay.MODE_SIZE) * line.n + 2 * line.k + line.m * lay.DRIVE_SIZE + j * lay.RING


@inlined
def pieces(line: LineArrays) -> Record:
    """`WEB_PIECES` of a line."""
    return record_in(line.s, past(line, line.m), WEB_PIECES)


@inlined
def boundary(line: LineArrays) -> Record:
    """`BOUNDARY` of a line."""
    return record_in(line.u, 0, BOUNDARY)


@inlined
def given(line: LineArrays, j: int) -> Record:
    """`DRIVE_INPUT` of motor j."""
    return record_in(line.u, lay.U_MOTORS + j * lay.UM_SIZE, DRIVE_INPUT)


@inlined
def block(line: LineArrays, b: int) -> int:
    """Offset of block b of integrated quantities in the scratch space."""
    return b * (4 * line.n + 2 * line.k)


@inlined
def call(line: LineArrays) -> Record:
    """`CALL` of a line."""
    return record_in(line.w, block(line, lay.BLOCKS), CALL)


@inlined
def part(line: LineArrays, i: int) -> Record:
    """`PART` of axis, motor or span i."""
    return record_in(line.w, block(line, lay.BLOCKS) + lay.CALL_SIZE + i * lay.PART_SIZE, PART)
