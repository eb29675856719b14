"""Sampled control loops of a drive, compiled: reference ramp, position P, velocity PI, current loop.

`drive_sample` is a drive firmware's work once per sample time; between samples the torque follows its command through a
first-order current loop (`torque_after`). SI, motor side.
"""

from __future__ import annotations

from math import exp
from typing import Final

from hilbench.compiled import Record, inlined, record_type
from hilbench.plant.motor_port import MotorMode

#: Motor modes as plain numbers, as compiled code compares them.
OFF, TORQUE, VELOCITY, POSITION = (
    float(mode) for mode in (MotorMode.OFF, MotorMode.TORQUE, MotorMode.VELOCITY, MotorMode.POSITION)
)

#: State of a drive.
DRIVE: Final = record_type(
    *("torque_Nm", "command_Nm", "integral_Nm", "reference", "limited", "mode"),
    "mean_Nm",  # mean torque in the last call of the kernel
)
DRIVE_INPUT: Final = record_type("mode", "setpoint", "slope", "limit_Nm")


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
def drive_sample(
    motor: Record, drive: Record, given: Record, sample_s: float, x_rad: float, v_rad_s: float, kp: float, ki: float,
    current_s: float,
) -> None:  # fmt: skip
    """Sample the loops of a `DRIVE`: new torque command from a `DRIVE_INPUT` and the measured motion.

    `motor`: with the loops' other parameters. `kp` (N·m·s/rad), `ki` (N·m/rad) and `current_s` (s): of its velocity and
    current loop, with effects. A new mode begins at the present value of its controlled quantity (bumpless transfer).
    """
    mode, limit, torque = given.mode, min(given.limit_Nm, motor.limit_Nm), drive.torque_Nm
    if drive.mode != mode:
        drive.mode, drive.integral_Nm = mode, torque
        drive.reference = x_rad if mode == POSITION else v_rad_s if mode == VELOCITY else torque
    if mode == OFF:
        drive.reference = drive.command_Nm = drive.torque_Nm = drive.integral_Nm = 0.0
        return
    before = drive.reference
    reference = ramp(before, given.setpoint, given.slope, sample_s)
    drive.reference = reference
    if mode == TORQUE:
        command = clip(reference, limit)
        limited = command != reference
    else:
        wanted = reference
        if mode == POSITION and given.slope >= 1e300:
            wanted = motor.position_kp * (reference - x_rad)
        elif mode == POSITION:
            # With the velocity of the ramp, which is `before` at the sample instant and gets to `reference` at its
            # end, as the position does.
            wanted = motor.position_kp * (before - x_rad) + (reference - before) / sample_s
        command, drive.integral_Nm, limited = velocity_loop(
            wanted - v_rad_s, drive.integral_Nm, kp, ki, limit, sample_s
        )
    drive.command_Nm = command
    if current_s == 0.0:
        drive.torque_Nm = command
    if limited:
        drive.limited = 1.0
