"""Transfer between motor ports and the kernel's vectors: set points in, feedback out."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.plant.motor_port import MotorPort
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector


def read_ports(
    layout: Layout, motors: Sequence[int], ports: Sequence[MotorPort], state: Vector, inputs: Vector
) -> None:
    """Read set points of the ports into the inputs; clears the torque-limited flags.

    `motors`: the kernel's motor, from 0, of each port.
    """
    for motor, port in zip(motors, ports, strict=False):
        at = lay.U_MOTORS + motor * lay.UM_SIZE
        inputs[at : at + lay.UM_SIZE] = port.mode, port.setpoint, port.slope, port.torque_limit_Nm
    first = _first_motor_state(layout) + lay.SM_LIMITED
    state[first : first + layout.motors * lay.SM_SIZE : lay.SM_SIZE] = 0.0


def write_ports(
    layout: Layout, motors: Sequence[int], p: Vector, ports: Sequence[MotorPort], state: Vector, out: Vector
) -> None:
    """Feedback from the columns of `kernel.observe` to the ports, exact (without sensors); `motors` as `read_ports`."""
    count, values = layout.motors, out.tolist()
    first_row, first_state = lay.W_SIZE + layout.axes * lay.A_SIZE, _first_motor_state(layout)
    for j, port in zip(motors, ports, strict=False):
        row, motor_state = first_row + j * lay.M_SIZE, first_state + j * lay.SM_SIZE
        rad_per_m = p.item(row + lay.M_RAD_PER_M)
        port.position_rad = values[j] * rad_per_m
        port.velocity_rad_s = values[count + j] * rad_per_m
        port.torque_Nm = values[2 * count + j]
        port.reference = state.item(motor_state + lay.SM_REFERENCE)
        port.torque_limited = state.item(motor_state + lay.SM_LIMITED) != 0.0


def _first_motor_state(layout: Layout) -> int:
    return lay.S_Y + layout.y_size + layout.axes * lay.SA_SIZE
