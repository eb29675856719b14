"""Transfer between motor ports and the kernel's vectors: set points in."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.compiled import Vector
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import DRIVE, Layout, column


def read_ports(
    layout: Layout, motors: Sequence[int], ports: Sequence[MotorPort], state: Vector, inputs: Vector
) -> None:
    """Read set points of the ports into the inputs; clears the torque-limited flags.

    `motors`: the kernel's motor, from 0, of each port.
    """
    for motor, port in zip(motors, ports, strict=False):
        at = lay.U_MOTORS + motor * lay.UM_SIZE
        inputs[at : at + lay.UM_SIZE] = port.mode, port.setpoint, port.slope, port.torque_limit_Nm
    first = layout.first_drive + column(DRIVE, "limited")
    state[first : first + layout.motors * lay.DRIVE_SIZE : lay.DRIVE_SIZE] = 0.0
