"""Compiled step of a rig whose motors stay in their modes: set points in, sensor readings out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, INDICES, TABLE, VECTOR, compiled, entry_point, floats, integers
from hilbench.cycle_program import CONTINUE
from hilbench.plant.sensor_rows import take_row
from hilbench.plant.web_line import records
from hilbench.plant.web_line.kernel import advance, observe
from hilbench.plant.web_line.layout import Vector

Table = NDArray[np.int64]
#: Feedback of a motor, in the order of `hilbench.plant.motor_port.MotorPort`: position, velocity, torque, reference,
#: torque limited (1) or not (0).
SHOWN = 5
#: Of each motor: standard deviations of position, velocity and torque, and the encoder's increment.
SENSOR = 4
#: Result of `step_by` when the normal numbers have to be drawn anew, and nothing was done.
DRAW = 1


@compiled
def show(
    p: Vector, s: Vector, out: Vector, motors: NDArray[np.int64], sensors: Vector, noise: Vector, shown: Vector
) -> None:
    """Write the motors' feedback from the observed values into `shown`; arguments as of `step`."""
    line = records.line_of(p, s, s, s)
    for k in range(len(motors)):
        j, at, of, count = motors[k], k * SHOWN, k * SENSOR, line.m
        rad_per_m, drive = records.motor(line, j).rad_per_m, records.drive(line, j)
        position = out[j] * rad_per_m + sensors[of] * noise[3 * k]
        counts = sensors[of + 3]
        # A count is a whole number, which has no -0.0.
        shown[at] = (np.rint(position / counts) + 0.0) * counts if counts > 0.0 else position
        shown[at + 1] = out[count + j] * rad_per_m + sensors[of + 1] * noise[3 * k + 1]
        shown[at + 2] = out[2 * count + j] + sensors[of + 2] * noise[3 * k + 2]
        shown[at + 3] = drive.reference
        shown[at + 4] = drive.limited != 0.0


#: step(parameters, state, inputs, work, out, motors (M,), set points (M,), samples, sensors (M · SENSOR,), normal
#: numbers (3 · M,), shown (M · SHOWN,)): `read_ports`, `kernel.advance`, `kernel.observe`, `write_ports` and `Sensors`.
@entry_point(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, INDICES, VECTOR, COUNT, VECTOR, VECTOR, VECTOR)
def step(
    p: Vector,
    s: Vector,
    u: Vector,
    work: Vector,
    out: Vector,
    motors: NDArray[np.int64],
    set_points: Vector,
    samples: int,
    sensors: Vector,
    noise: Vector,
    shown: Vector,
) -> None:
    line = records.line_of(p, s, u, work)
    for k in range(len(motors)):
        records.given(line, motors[k]).setpoint = set_points[k]
    for j in range(line.m):
        records.drive(line, j).limited = 0.0
    advance(p, s, u, work, samples)
    observe(p, s, u, work, out, False)
    show(p, s, out, motors, sensors, noise, shown)


#: step_by(samples, table of the vectors in this order but for the numbers, which are the last two, as of
#: `sensor_rows.take_row`): `step`.
@entry_point(COUNT, TABLE)
def step_by(samples: int, table: Table) -> int:
    numbers = floats(table, 9, (1, 2))
    row = take_row(numbers, integers(table, 10, (1,)))
    if row < 0:
        return DRAW
    p, s, u = floats(table, 0, (1,)), floats(table, 1, (1,)), floats(table, 2, (1,))
    work, out, motors = floats(table, 3, (1,)), floats(table, 4, (1,)), integers(table, 5, (1,))
    set_points, sensors, shown = floats(table, 6, (1,)), floats(table, 7, (1,)), floats(table, 8, (1,))
    step(p, s, u, work, out, motors, set_points, samples, sensors, numbers[row], shown)
    return CONTINUE
