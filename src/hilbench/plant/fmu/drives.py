"""Drives of an FMU's motors, compiled: their loops once a sample time, and the torque on the FMU in it."""

from __future__ import annotations

from hilbench.compiled import VECTOR, entry_point
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line import places
from hilbench.plant.web_line.layout import Vector


#: sample(parameters, state, inputs): one sample time of all drives on the motion in the state; returns the mean sum of
#: torques on the shaft in it, N·m. The state is changed in place; the motion at its end comes from the FMU.
@entry_point(VECTOR, VECTOR, VECTOR)
def sample(p: Vector, s: Vector, u: Vector) -> float:
    period, total, motors = p[lay.P_SAMPLE_TIME_S], u[lay.U_TORQUE_NM], int(p[line.W_MOTORS])
    s[line.S_COUNT] += 1.0
    for j in range(motors):
        gains, at, inputs = (
            places.motor(1, j) + line.M_LOOPS,
            places.motor_state(1, 0, j),
            line.U_MOTORS + j * line.UM_SIZE,
        )
        current_s = p[gains + loops.CURRENT_S]
        loops.drive_sample(
            p, s, u, gains, at, inputs, period, s[lay.S_X], s[lay.S_V], p[gains + loops.KP], p[gains + loops.KI],
            current_s,
        )  # fmt: skip
        command, before = s[at + loops.COMMAND_NM], s[at + loops.TORQUE_NM]
        decay = loops.current_decay(period, current_s)
        mean = command + (before - command) * (current_s * (1.0 - decay) / period)
        s[at + loops.TORQUE_NM] = loops.torque_after(before, command, decay)
        s[at + line.SM_MEAN_NM] += mean
        total += mean
        s[places.past(1, motors, 0, j) + int(s[line.S_COUNT]) % line.RING] = s[at + loops.TORQUE_NM]
    return float(total)
