"""Compiled step of a rig whose motors stay in their modes: set points in, sensor readings out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hilbench.compiled import COUNT, TABLE, Reals, Reals2, Table, Vector, Wholes, arrays_in, compiled, entry_point
from hilbench.cycle_program import CONTINUE
from hilbench.plant.motor_port import FEEDBACK_SIZE
from hilbench.plant.sensor_rows import ALWAYS_FIRST
from hilbench.plant.web_line import kernel, records
from hilbench.plant.web_line.line_vectors import LineVectors, arrays

#: Of each motor: standard deviations of position, velocity and torque, and the encoder's increment.
SENSOR = 4
#: Result of `step_noisy` when the normal numbers have to be drawn anew, and nothing was done.
DRAW = 1


class RigArrays(NamedTuple):
    """A line and what its motors get and show: rows of the motors with ports (M,), their set points (M,), figures of
    their sensors (M · SENSOR,), their feedback (M · FEEDBACK_SIZE,), as of
    `hilbench.plant.motor_port`."""

    line: LineVectors
    motors: Wholes
    asked: Reals
    sensors: Reals
    shown: Reals


class NoisyRig(NamedTuple):
    """Rig with the normal numbers of its sensors, and the row of the next step."""

    rig: RigArrays
    numbers: Reals2
    next_row: Wholes


@compiled
def show(rig: RigArrays, noise: Vector) -> None:
    """Write the motors' feedback from the observed values, with normal numbers (3 · M,)."""
    line, out, sensors, shown = arrays(rig.line), rig.line.out, rig.sensors, rig.shown
    for k in range(len(rig.motors)):
        j, at, of, count = rig.motors[k], k * FEEDBACK_SIZE, k * SENSOR, line.m
        rad_per_m, drive = records.motor(line, j).rad_per_m, records.drive(line, j)
        position = out[j] * rad_per_m + sensors[of] * noise[3 * k]
        counts = sensors[of + 3]
        # A count is a whole number, which has no -0.0.
        shown[at] = (np.rint(position / counts) + 0.0) * counts if counts > 0.0 else position
        shown[at + 1] = out[count + j] * rad_per_m + sensors[of + 1] * noise[3 * k + 1]
        shown[at + 2] = out[2 * count + j] + sensors[of + 2] * noise[3 * k + 2]
        shown[at + 3] = drive.reference
        shown[at + 4] = drive.limited != 0.0


@compiled
def step(rig: RigArrays, samples: int, noise: Vector) -> None:
    """Step the motors in their modes, with their set points."""
    line = arrays(rig.line)
    for k in range(len(rig.motors)):
        records.given(line, rig.motors[k]).setpoint = rig.asked[k]
    for j in range(line.m):
        records.drive(line, j).limited = 0.0
    kernel.advance(line.p, line.s, line.u, line.w, samples)
    kernel.observe(*rig.line)
    show(rig, noise)


@compiled
def step_noisy(noisy: NoisyRig, samples: int) -> int:
    """`step` with the next numbers; without samples only `show`."""
    row, following = 0, noisy.next_row
    if following[0] != ALWAYS_FIRST:
        row = following[0]
        if row == len(noisy.numbers):
            return DRAW
        following[0] += 1
    if samples > 0:
        step(noisy.rig, samples, noisy.numbers[row])
    else:
        show(noisy.rig, noisy.numbers[row])
    return CONTINUE


#: step_by(samples, table of a `NoisyRig`).
@entry_point(COUNT, TABLE, allocates=False)
def step_by(samples: int, table: Table) -> int:
    return step_noisy(arrays_in(table, NoisyRig), samples)
