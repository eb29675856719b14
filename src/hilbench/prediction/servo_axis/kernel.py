"""Futures of a servo axis: the plant's kernel driven by future set points, compiled.

The closed loop of shaft and drive at one coarse step: the drive's loop samples once per step, the mechanics are
integrated by the plant's own kernel, with every effect of the model; the load motor's torque follows the law of
`hilbench.plant.web_line.shaft_load`. Vectors as in `hilbench.plant.servo_axis.layout`. B futures, T steps; the watched
quantities, Q = 3, in this order: torques of the axis's motor as reported by its drive and of the load motor (N·m),
speed of the axis (rad/s).
"""

from __future__ import annotations

from typing import Annotated, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, Reals, Reals2, arrays_in, compiled, entry_point, record_type
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.web_line import kernel, records
from hilbench.plant.web_line.shaft_load import load_torque_Nm
from hilbench.prediction.judging import TallyVectors, keep, see

Indices = NDArray[np.int64]

# Watched quantities.
Q_TORQUE: Final = 0
Q_LOAD_TORQUE: Final = 1
Q_SPEED: Final = 2
QUANTITIES: Final = 3
# Columns of the set points at the start of each step.
C_COMMAND: Final = 0  #: rad/s
C_INERTIA: Final = 1  #: as a share of the present one
C_DRY: Final = 2  #: dry friction beyond the present one, N·m
COURSES: Final = 3
# Columns of the draws of a future's shaft.
D_INERTIA: Final = 0  #: kg·m², without the model's effects
D_DRY: Final = 1  #: dry friction, N·m, without the model's effects
D_VISCOUS: Final = 2  #: viscous friction, N·m·s/rad, without the model's effects
DRAWN: Final = 3


#: Slope of the emulated dry friction at standstill, N·m·s/rad; measurements in a step, steps in a row.
FIGURES: Final = record_type("steepest", "samples", "every")


class ShaftFuture(NamedTuple):
    """Vectors and figures of a prediction: parameters, those of the rig as assumed, states (B, S), draws (B, DRAWN),
    courses (T, COURSES); room for state, inputs, scratch, observed values and quantities."""

    p: Reals
    real: Reals
    start: Reals2
    shaft: Reals2
    courses: Reals2
    s: Reals
    u: Reals
    w: Reals
    out: Reals
    q: Reals
    tally: TallyVectors
    figures: Annotated[Any, FIGURES]


@compiled
def _run(a: ShaftFuture, line: records.LineArrays, b: int) -> None:
    """Run future b to its end."""
    row, every, s, w = 0, int(a.figures.every), line.s, line.w
    until_row = every
    axis, mode, drawn, q = records.axis(line, 0), records.mode(line, 0), a.shaft[b], a.q
    real = records.of_parameters(a.real)
    axis.viscous_N_s_per_m = max(drawn[D_VISCOUS], 0.0)
    for i in range(a.courses.shape[0]):
        axis.roller_mass_kg = drawn[D_INERTIA] * a.courses[i, C_INERTIA]
        axis.coulomb_N = max(drawn[D_DRY] + a.courses[i, C_DRY], 0.0)
        if s[lay.S_V] != 0.0:  # dry friction that begins in motion is against it
            mode.direction = 1.0 if s[lay.S_V] > 0.0 else -1.0
        records.given(line, 0).setpoint = a.courses[i, C_COMMAND]
        kernel.enter(line)
        kernel.go_on(line, 1)
        kernel.report(line, a.out, 0)
        q[Q_SPEED], q[Q_TORQUE], now_s = a.out[1], a.out[2], kernel.time_s(line)
        acceleration = kernel.acceleration_m_s2(line, now_s, 0)
        emulated = load_torque_Nm(line, real, now_s, w[0], w[1], acceleration, a.figures.steepest)
        q[Q_LOAD_TORQUE] = loops.clip(emulated, records.motor(real, 1).limit_Nm)
        kernel.leave(line)
        see(a.tally, q, a.figures.samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(a.tally, q, b, row)
            row, until_row = row + 1, every


#: run_futures(0, table of a `ShaftFuture`).
@entry_point(COUNT, TABLE, allocates=False)
def run_futures(unused: int, table: Indices) -> int:
    a = arrays_in(table, ShaftFuture)
    for b in range(len(a.start)):
        for j in range(len(a.s)):
            a.s[j] = a.start[b, j]
        _run(a, records.line_of(a.p, a.s, a.u, a.w), b)
    return 0
