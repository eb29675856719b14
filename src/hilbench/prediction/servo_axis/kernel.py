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
from hilbench.plant.servo_axis import kernel
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.emulation import load_torque_Nm
from hilbench.plant.servo_axis.layout import Vector
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
def _change_shaft(p: Vector, shaft: Matrix, b: int, courses: Matrix, i: int) -> None:
    """Set inertia and friction of future b in step i."""
    p[lay.P_INERTIA] = shaft[b, D_INERTIA] * courses[i, C_INERTIA]
    p[lay.P_COULOMB], p[lay.P_VISCOUS] = max(shaft[b, D_DRY] + courses[i, C_DRY], 0.0), max(shaft[b, D_VISCOUS], 0.0)


@inlined
def _watched(p: Vector, real: Vector, steepest: float, s: Vector, u: Vector, out: Vector, q: Vector) -> None:
    """Write the present quantities to q (Q,); out: scratch for observed values."""
    kernel.report(p, s, out, 0)
    q[Q_TORQUE], q[Q_SPEED] = out[lay.O_TORQUE], out[lay.O_V]
    now_s, a = s[lay.S_COUNT] * p[lay.P_SAMPLE_TIME_S], kernel.acceleration_rad_s2(p, s, u)
    emulated = load_torque_Nm(p, real, now_s, s[lay.S_X], s[lay.S_V], a, steepest)
    q[Q_LOAD_TORQUE] = loops.clip(emulated, real[lay.P_LOOPS + loops.LOOPS_SIZE + loops.LIMIT_NM])


@compiled
def _run(
    p: Vector,
    real: Vector,
    steepest: float,
    shaft: Matrix,
    courses: Matrix,
    s: Vector,
    u: Vector,
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
        _change_shaft(p, shaft, b, courses, i)
        u[lay.U_MOTORS + loops.IN_SETPOINT] = courses[i, C_COMMAND]
        kernel.go_on(p, s, u, 1)
        _watched(p, real, steepest, s, u, out, q)
        see(tally, q, samples, b, i)
        until_row -= 1
        if until_row == 0:
            keep(tally, q, b, row)
            row, until_row = row + 1, every


#: run_futures(parameters, those of the rig as assumed, slope of the emulated dry friction at standstill, states (B, S),
#: draws (B, DRAWN), courses (T, COURSES), state, inputs, observed, quantities, table of the tally (`Tally.table`),
#: measurements in a step, steps in a row).
@entry_point(
    *[VECTOR] * 2,
    REAL,
    *[MATRIX] * 3,
    *[VECTOR] * 4,
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
    out: Vector,
    q: Vector,
    table: Indices,
    samples: float,
    every: int,
) -> None:
    tally = of_table(table)
    for b in range(start.shape[0]):
        s[:] = start[b]
        _run(p, real, steepest, shaft, courses, s, u, out, q, tally, samples, every, b)
