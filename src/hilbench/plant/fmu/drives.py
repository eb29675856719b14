"""Drives of an FMU's motors, compiled: their loops once a sample time, and the torque on the FMU in it."""

from __future__ import annotations

from hilbench.compiled import VECTOR, Vector, entry_point
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.web_line import records
from hilbench.plant.web_line.layout import RING, S_COUNT


#: sample(parameters, state, inputs): one sample time of all drives on the motion in the state; returns the mean sum of
#: torques on the shaft in it, N·m. The state is changed in place; the motion at its end comes from the FMU.
@entry_point(VECTOR, VECTOR, VECTOR)
def sample(p: Vector, s: Vector, u: Vector) -> float:
    line, total = records.line_of(p, s, u, s), u[lay.U_TORQUE_NM]
    period = records.web(line).sample_time_s
    s[S_COUNT] += 1.0
    for j in range(line.m):
        motor, drive, given = records.motor(line, j), records.drive(line, j), records.given(line, j)
        loops.drive_sample(motor, drive, given, period, s[lay.S_X], s[lay.S_V], motor.kp, motor.ki, motor.current_s)
        command, before = drive.command_Nm, drive.torque_Nm
        decay = loops.current_decay(period, motor.current_s)
        mean = command + (before - command) * (motor.current_s * (1.0 - decay) / period)
        drive.torque_Nm = loops.torque_after(before, command, decay)
        drive.mean_Nm += mean
        total += mean
        s[records.past(line, j) + int(s[S_COUNT]) % RING] = drive.torque_Nm
    return float(total)
