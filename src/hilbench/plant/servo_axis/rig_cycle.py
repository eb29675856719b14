"""Compiled step of a shaft whose motors stay in their modes: set points in, sensor readings out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, TABLE, VECTOR, entry_point, floats, integers
from hilbench.cycle_program import CONTINUE
from hilbench.plant import drive_loops as loops
from hilbench.plant.sensor_rows import take_row
from hilbench.plant.servo_axis import kernel
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import Vector

Table = NDArray[np.int64]
#: Feedback of a motor, in the order of `hilbench.plant.motor_port.MotorPort`: position, velocity, torque, reference,
#: torque limited (1) or not (0).
SHOWN = 5
#: Of each motor: standard deviations of position, velocity and torque, and the encoder's increment.
SENSOR = 4
#: Result of `step_by` when the normal numbers have to be drawn anew, and nothing was done.
DRAW = 1


#: step(table of parameters, state, inputs, out, set points (M,), sensors (M · SENSOR,), shown (M · SHOWN,); samples,
#: normal numbers (3 · M,)): `kernel.advance` and `kernel.observe`, with ports that stay as they are, and `Sensors`.
@entry_point(TABLE, COUNT, VECTOR)
def step(table: Table, samples: int, noise: Vector) -> None:
    if len(table) == 0:
        return
    p, s, u, out = floats(table, 0, (1,)), floats(table, 1, (1,)), floats(table, 2, (1,)), floats(table, 3, (1,))
    set_points, sensors, shown = floats(table, 4, (1,)), floats(table, 5, (1,)), floats(table, 6, (1,))
    for k in range(len(set_points)):
        u[lay.U_MOTORS + k * loops.IN_SIZE + loops.IN_SETPOINT] = set_points[k]
        s[lay.S_MOTORS + k * loops.STATE_SIZE + loops.LIMITED] = 0.0
    kernel.go_on(p, s, u, samples)
    kernel.report(p, s, out, 0)
    for k in range(len(set_points)):
        at, of, state = k * SHOWN, k * SENSOR, lay.S_MOTORS + k * loops.STATE_SIZE
        position, counts = out[lay.O_X] + sensors[of] * noise[3 * k], sensors[of + 3]
        # A count is a whole number, which has no -0.0.
        shown[at] = (np.rint(position / counts) + 0.0) * counts if counts > 0.0 else position
        shown[at + 1] = out[lay.O_V] + sensors[of + 1] * noise[3 * k + 1]
        shown[at + 2] = out[lay.O_TORQUE + k] + sensors[of + 2] * noise[3 * k + 2]
        shown[at + 3] = s[state + loops.REFERENCE]
        shown[at + 4] = s[state + loops.LIMITED] != 0.0


#: step_by(samples, table of the vectors in this order, followed by the numbers, as of `sensor_rows.take_row`): `step`.
@entry_point(COUNT, TABLE)
def step_by(samples: int, table: Table) -> int:
    numbers = floats(table, 7, (1, 2))
    row = take_row(numbers, integers(table, 8, (1,)))
    if row < 0:
        return DRAW
    step(table, samples, numbers[row])
    return CONTINUE
