"""Export of a servo axis as an FMU, with or without its drive."""

from __future__ import annotations

from math import inf

from hilbench.plant.fmu.export.machine import (
    FORGOTTEN,
    ExportedMachine,
    ExportedVariable,
    P,
    Place,
    U,
    asked,
    output,
    parameter,
)
from hilbench.plant.fmu.export.web_line import LINE
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.layout import PARAMETERS
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.servo_axis.shaft import Shaft
from hilbench.plant.web_line import layout as line


def exported_axis(model: ServoAxisParameters, *, drives: bool) -> ExportedMachine:
    """Export definition of a servo axis. With its drive's loops the input is a speed, without it the motor's torque.

    Raises ValueError for an axis without drive.
    """
    if drives and model.drives is None:
        raise ValueError("'drives:' in the machine for an FMU with its drive")
    machine = Shaft(model, None, ())
    vectors, layout = machine.vectors, machine._layout
    p, u = vectors.p.copy(), vectors.u.copy()
    layout.motor_inputs(u).mode = MotorMode.VELOCITY if drives else MotorMode.TORQUE
    if not drives:
        motors = layout.motor_rows(p)
        motors.limit_Nm, motors.current_s = inf, 0.0
    columns = (column for column, _ in machine._columns)
    variables = [output(quantity, at) for quantity, at in zip(machine.describe().outputs, columns, strict=True)]
    variables.append(asked(1, "rad", Place(U, lay.U_SETPOINT), drives=drives))
    outside = machine.describe().inputs[0]
    variables.append(ExportedVariable(outside, "input", (Place(U, lay.U_TORQUE_NM),)))
    variables += [parameter(quantity, Place(P, column)) for quantity, column in PARAMETERS.values()]
    sample_s = float(p[lay.P_SAMPLE_TIME_S])
    return ExportedMachine(
        name="servo_axis" if drives else "servo_axis_mechanics",
        description="servo axis" + (" with its drive" if drives else ""),
        kernel=LINE, p=p, s=vectors.s.copy(), u=u, work=len(vectors.w), out=len(vectors.out),
        variables=tuple(variables),
        forgotten=(Place(FORGOTTEN, layout.first_drive + line.column(line.DRIVE, "limited")),),
        sample_s=sample_s, time=(line.S_COUNT, 1.0 / sample_s),
    )  # fmt: skip
