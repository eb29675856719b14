"""Drives of an FMU's motors, compiled: their loops once a sample time, and the torque on the FMU in it."""

from __future__ import annotations

from hilbench.compiled import VECTOR, entry_point
from hilbench.plant import drive_loops as loops
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import Vector


#: sample(parameters, state, inputs): one sample time of all drives on the motion in the state; returns the mean sum of
#: torques on the shaft in it, N·m. The state is changed in place; the motion at its end comes from the FMU.
@entry_point(VECTOR, VECTOR, VECTOR)
def sample(p: Vector, s: Vector, u: Vector) -> float:
    period, total = p[lay.P_SAMPLE_TIME_S], u[lay.U_TORQUE_NM]
    for j in range(int(p[lay.P_MOTORS])):
        gains, at = lay.P_LOOPS + j * loops.LOOPS_SIZE, lay.S_MOTORS + j * loops.STATE_SIZE
        current_s = p[gains + loops.CURRENT_S]
        loops.drive_sample(
            p, s, u, gains, at, lay.U_MOTORS + j * loops.IN_SIZE, period, s[lay.S_X], s[lay.S_V],
            p[gains + loops.KP], p[gains + loops.KI], current_s,
        )  # fmt: skip
        command, before = s[at + loops.COMMAND_NM], s[at + loops.TORQUE_NM]
        decay = loops.current_decay(period, current_s)
        mean = command + (before - command) * (current_s * (1.0 - decay) / period)
        s[at + loops.TORQUE_NM] = loops.torque_after(before, command, decay)
        if j == 0:
            s[lay.S_MEAN] += mean
        total += mean
    s[lay.S_COUNT] += 1.0
    s[lay.S_PAST + int(s[lay.S_COUNT]) % lay.RING] = s[lay.S_MOTORS + loops.TORQUE_NM]
    return float(total)
