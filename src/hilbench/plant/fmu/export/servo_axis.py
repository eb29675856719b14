"""Export of a servo axis as an FMU, with or without its drive."""

from __future__ import annotations

from math import inf

from hilbench.plant import drive_loops as loops
from hilbench.plant.fmu.export.machine import (
    FORGOTTEN,
    ExportedMachine,
    ExportedVariable,
    Kernel,
    P,
    Place,
    U,
    asked,
    output,
    parameter,
)
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis import kernel
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import PARAMETERS, Vector
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import Shaft


def _go(p: Vector, s: Vector, u: Vector, w: Vector, out: Vector, samples: int, duration: float) -> None:
    """Step a servo axis with its drive; `out` as of `servo_axis.layout`."""
    if samples > 0:
        kernel.go_on(p, s, u, samples)
    kernel.report(p, s, out, 0)


_KERNEL = Kernel("axis", _go)


def exported_axis(model: ServoAxisParameters, *, drives: bool) -> ExportedMachine:
    """Export definition of a servo axis. With its drive's loops the input is a speed, without it the motor's torque.

    Raises ValueError for an axis without drive.
    """
    if drives and model.drives is None:
        raise ValueError("'drives:' in the machine for an FMU with its drive")
    machine = Shaft(model, None, (), 1)
    p, u = machine.packed.copy(), machine._inputs.copy()
    inputs = lay.motor_inputs(u)
    inputs[:, loops.IN_MODE] = MotorMode.VELOCITY if drives else MotorMode.TORQUE
    if not drives:
        p[lay.P_LOOPS + loops.LIMIT_NM], p[lay.P_LOOPS + loops.CURRENT_S] = inf, 0.0
    set_point = Place(U, lay.U_MOTORS + loops.IN_SETPOINT)
    variables = [output(quantity, at) for at, quantity in enumerate(machine.describe().outputs)]
    variables.append(asked(1, "rad", set_point, drives=drives))
    outside = machine.describe().inputs[0]
    variables.append(ExportedVariable(outside, "input", (Place(U, lay.U_TORQUE_NM),)))
    variables += [parameter(quantity, Place(P, column)) for quantity, column in PARAMETERS.values()]
    sample_s = float(p[lay.P_SAMPLE_TIME_S])
    return ExportedMachine(
        name="servo_axis" if drives else "servo_axis_mechanics",
        description="servo axis" + (" with its drive" if drives else ""),
        kernel=_KERNEL, p=p, s=machine._state.copy(), u=u, work=1, out=lay.output_size(p),
        variables=tuple(variables),
        forgotten=(Place(FORGOTTEN, lay.S_MOTORS + loops.LIMITED),),
        sample_s=sample_s, time=(lay.S_COUNT, 1.0 / sample_s),
    )  # fmt: skip
