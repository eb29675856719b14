"""Transfer between motor ports and the kernel's vectors: set points in, feedback out."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.motor_port import MotorPort
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import DRIVE, Layout, Vector, column

#: By scalar access, in every cycle.
_REFERENCE, _LIMITED = column(DRIVE, "reference"), column(DRIVE, "limited")


def read_ports(
    layout: Layout, motors: Sequence[int], ports: Sequence[MotorPort], state: Vector, inputs: Vector
) -> None:
    """Read set points of the ports into the inputs; clears the torque-limited flags.

    `motors`: the kernel's motor, from 0, of each port.
    """
    for motor, port in zip(motors, ports, strict=False):
        at = lay.U_MOTORS + motor * lay.UM_SIZE
        inputs[at : at + lay.UM_SIZE] = port.mode, port.setpoint, port.slope, port.torque_limit_Nm
    first = layout.first_drive + _LIMITED
    state[first : first + layout.motors * lay.DRIVE_SIZE : lay.DRIVE_SIZE] = 0.0


def write_ports(
    layout: Layout, motors: Sequence[int], p: Vector, ports: Sequence[MotorPort], state: Vector, out: Vector
) -> None:
    """Feedback from the columns of `kernel.observe` to the ports, exact (without sensors); `motors` as `read_ports`."""
    count, values = layout.motors, out.tolist()
    first_drive, first_motor = layout.first_drive, layout.first_motor
    for j, port in zip(motors, ports, strict=False):
        drive, rad_per_m = first_drive + j * lay.DRIVE_SIZE, p.item(first_motor + j * lay.M_SIZE)
        port.position_rad = values[j] * rad_per_m
        port.velocity_rad_s = values[count + j] * rad_per_m
        port.torque_Nm = values[2 * count + j]
        port.reference = state.item(drive + _REFERENCE)
        port.torque_limited = state.item(drive + _LIMITED) != 0.0
