"""Futures of a servo axis: the plant's kernel driven by future set points, compiled.

The closed loop of shaft and drive at one coarse step: the drive's loop samples once per step, the mechanics are
integrated by the plant's own kernel, with every effect of the model; the load motor's torque follows the law of
`hilbench.plant.servo_axis.emulation`. Vectors as in `hilbench.plant.servo_axis.layout`. B futures, T steps; the watched
quantities, Q = 3, in this order: torques of the axis's motor as reported by its drive and of the load motor (N·m),
speed of the axis (rad/s).
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, MATRIX, REAL, TABLE, VECTOR, compiled, entry_point, inlined
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.emulation import load_torque_Nm
from hilbench.plant.web_line import kernel, places
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line.layout import Vector
from hilbench.prediction.judging import TallyVectors, keep, of_table, see

Matrix = NDArray[np.float64]
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


@inlined
def _change_shaft(p: Vector, s: Vector, shaft: Matrix, b: int, courses: Matrix, i: int) -> None:
    """Set inertia and friction of future b in step i; dry friction that begins in motion is against it."""
    p[lay.P_INERTIA] = shaft[b, D_INERTIA] * courses[i, C_INERTIA]
    p[lay.P_COULOMB], p[lay.P_VISCOUS] = max(shaft[b, D_DRY] + courses[i, C_DRY], 0.0), max(shaft[b, D_VISCOUS], 0.0)
    if s[lay.S_V] != 0.0:
        s[lay.S_DIRECTION] = 1.0 if s[lay.S_V] > 0.0 else -1.0


@inlined
def _watched(p: Vector, real: Vector, steepest: float, s: Vector, u: Vector, w: Vector, out: Vector, q: Vector) -> None:
    """Write the present quantities to q (Q,); out: scratch for observed values; between `enter` and `leave`."""
    kernel.report(p, s, u, w, out, 0)
    q[Q_SPEED], q[Q_TORQUE] = out[1], out[2]
    now_s, x, v = s[line.S_COUNT] * p[lay.P_SAMPLE_TIME_S], w[0], w[1]
    a = kernel.acceleration_m_s2(p, s, u, w, now_s, 0)
    emulated = load_torque_Nm(p, real, now_s, x, v, a, steepest)
    q[Q_LOAD_TORQUE] = loops.clip(emulated, real[lay.LOAD_MOTOR + line.M_LIMIT_NM])


@compiled
def _run(
    p: Vector,
    real: Vector,
    steepest: float,
    shaft: Matrix,
    courses: Matrix,
    s: Vector,
    u: Vector,
    w: Vector,
    out: Vector,
    q: Vector,
    tally: TallyVectors,
    samples: float,
    every: int,
    b: int,
) -> None:
    """Run future b to its end."""
    row, until_row = 0, every
    for i in range(courses.shape[0]):
        _change_shaft(p, s, shaft, b, courses, i)
        u[lay.U_SETPOINT] = courses[i, C_COMMAND]
        kernel.enter(p, s, u, w)
        kernel.go_on(p, s, u, w, 1)
        _watched(p, real, steepest, s, u, w, out, q)
        kernel.leave(s, w, places.block(1, 0, 1))
        see(tally, q, samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(tally, q, b, row)
            row, until_row = row + 1, every


#: run_futures(parameters, those of the rig as assumed, slope of the emulated dry friction at standstill, states (B, S),
#: draws (B, DRAWN), courses (T, COURSES), state, inputs, scratch, observed, quantities, table of the tally
#: (`Tally.table`), measurements in a step, steps in a row).
@entry_point(
    *[VECTOR] * 2,
    REAL,
    *[MATRIX] * 3,
    *[VECTOR] * 5,
    TABLE,
    REAL,
    COUNT,
)
def run_futures(
    p: Vector,
    real: Vector,
    steepest: float,
    start: Matrix,
    shaft: Matrix,
    courses: Matrix,
    s: Vector,
    u: Vector,
    w: Vector,
    out: Vector,
    q: Vector,
    table: Indices,
    samples: float,
    every: int,
) -> None:
    tally = of_table(table)
    for b in range(start.shape[0]):
        s[:] = start[b]
        _run(p, real, steepest, shaft, courses, s, u, w, out, q, tally, samples, every, b)
