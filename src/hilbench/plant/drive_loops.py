"""Sampled control loops of a drive, compiled: reference ramp, position P, velocity PI, current loop.

`velocity_reference` and `velocity_loop` are a drive firmware's work once per sample time; between samples the torque
follows its command through a first-order current loop (`torque_after`). SI, motor side. Used by
`hilbench.plant.web_line.kernel`, which holds the state in flat arrays.
"""

from __future__ import annotations

from math import exp
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import inlined
from hilbench.plant.motor_port import MotorMode

#: Motor modes as plain numbers, as compiled code compares them.
OFF, TORQUE, VELOCITY, POSITION = (
    float(mode) for mode in (MotorMode.OFF, MotorMode.TORQUE, MotorMode.VELOCITY, MotorMode.POSITION)
)

Vector = NDArray[np.float64]

# Parameters of a drive's loops, motor side.
KP: Final = 0
KI: Final = 1
POSITION_KP: Final = 2
LIMIT_NM: Final = 3
CURRENT_S: Final = 4
LOOPS_SIZE: Final = 5
# State of a drive.
TORQUE_NM: Final = 0
COMMAND_NM: Final = 1
INTEGRAL_NM: Final = 2
REFERENCE: Final = 3
LIMITED: Final = 4
MODE: Final = 5
STATE_SIZE: Final = 6
# Inputs of a drive.
IN_MODE: Final = 0
IN_SETPOINT: Final = 1
IN_SLOPE: Final = 2
IN_LIMIT_NM: Final = 3
IN_SIZE: Final = 4


@inlined
def clip(value: float, limit: float) -> float:
    """Clip `value` to ±`limit`."""
    return min(max(value, -limit), limit)


@inlined
def ramp(reference: float, setpoint: float, slope: float, sample_time_s: float) -> float:
    """Reference one sample later: towards the set point, at most `slope` per second."""
    return reference + clip(setpoint - reference, slope * sample_time_s)


@inlined
def velocity_loop(
    error_rad_s: float, integral_Nm: float, kp: float, ki: float, limit_Nm: float, sample_time_s: float
) -> tuple[float, float, bool]:
    """One sample of the velocity PI: torque command, new integral, and saturation flag.

    Anti-windup by conditional integration: at the limit the integral only moves back from it.
    """
    integral = integral_Nm + ki * error_rad_s * sample_time_s
    wanted = kp * error_rad_s + integral
    torque = clip(wanted, limit_Nm)
    if wanted != torque:
        if (wanted - torque) * error_rad_s > 0.0:
            integral = clip(integral_Nm, limit_Nm)
        return torque, integral, True
    return torque, integral, False


@inlined
def current_decay(duration_s: float, time_constant_s: float) -> float:
    """Remaining share of the distance between torque and command after `duration_s` (exact for a held command)."""
    return exp(-duration_s / time_constant_s) if time_constant_s > 0.0 else 0.0


@inlined
def torque_after(torque_Nm: float, command_Nm: float, decay: float) -> float:
    """Torque of the first-order current loop when the distance to the command has shrunk to `decay`."""
    return command_Nm + (torque_Nm - command_Nm) * decay


@inlined
def bumpless_reference(mode: float, position_rad: float, velocity_rad_s: float, torque_Nm: float) -> float:
    """Initial reference of a mode (bumpless transfer): the present value of the controlled quantity."""
    if mode == POSITION:
        return position_rad
    if mode == VELOCITY:
        return velocity_rad_s
    return torque_Nm


@inlined
def velocity_reference(
    mode: float, before: float, reference: float, position_rad: float, kp_per_s: float, slope: float, sample_s: float
) -> float:
    """Reference of the velocity loop; the position loop adds the velocity of a ramped reference (feed-forward).

    A ramped reference is `before` at the sample instant and gets to `reference` at its end, as the position does.
    """
    if mode != POSITION:
        return reference
    if slope >= 1e300:
        return kp_per_s * (reference - position_rad)
    return kp_per_s * (before - position_rad) + (reference - before) / sample_s


@inlined
def drive_sample(
    p: Vector,
    s: Vector,
    u: Vector,
    gains: int,
    state: int,
    inputs: int,
    period_s: float,
    position_rad: float,
    velocity_rad_s: float,
    kp: float,
    ki: float,
    current_s: float,
) -> None:
    """Sample a drive's loops: new torque command from set point and measured motion.

    `gains`, `state`, `inputs`: offsets of its loops' parameters in `p`, its state in `s`, its inputs in `u`. `kp`
    (N·m·s/rad), `ki` (N·m/rad) and `current_s` (s): of its velocity and current loop, with effects.
    """
    mode, slope = u[inputs + IN_MODE], u[inputs + IN_SLOPE]
    limit = min(u[inputs + IN_LIMIT_NM], p[gains + LIMIT_NM])
    torque = s[state + TORQUE_NM]
    if s[state + MODE] != mode:
        s[state + MODE] = mode
        s[state + REFERENCE] = bumpless_reference(mode, position_rad, velocity_rad_s, torque)
        s[state + INTEGRAL_NM] = torque
    if mode == OFF:
        s[state + REFERENCE] = 0.0
        s[state + COMMAND_NM] = 0.0
        s[state + TORQUE_NM] = 0.0
        s[state + INTEGRAL_NM] = 0.0
        return
    before = s[state + REFERENCE]
    reference = ramp(before, u[inputs + IN_SETPOINT], slope, period_s)
    s[state + REFERENCE] = reference
    if mode == TORQUE:
        command = clip(reference, limit)
        limited = command != reference
    else:
        kp_position = p[gains + POSITION_KP]
        wanted = velocity_reference(mode, before, reference, position_rad, kp_position, slope, period_s)
        command, s[state + INTEGRAL_NM], limited = velocity_loop(
            wanted - velocity_rad_s, s[state + INTEGRAL_NM], kp, ki, limit, period_s
        )
    s[state + COMMAND_NM] = command
    if current_s == 0.0:
        s[state + TORQUE_NM] = command
    if limited:
        s[state + LIMITED] = 1.0
