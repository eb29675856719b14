"""Between motor ports and the kernel's vectors: set points in, feedback out."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.drives.port import MotorPort
from hilbench.web import layout as lay
from hilbench.web.layout import Layout, Vector


def read_ports(layout: Layout, ports: Sequence[MotorPort], state: Vector, inputs: Vector) -> None:
    """Set points of the ports into the inputs; forgets that a limit was reached earlier."""
    at = lay.U_MOTORS
    for port in ports:
        inputs[at + lay.UM_MODE] = port.mode
        inputs[at + lay.UM_SETPOINT] = port.setpoint
        inputs[at + lay.UM_SLOPE] = port.slope
        inputs[at + lay.UM_LIMIT_NM] = port.torque_limit_Nm
        at += lay.UM_SIZE
    layout.motor_states(state)[:, lay.SM_LIMITED] = 0.0


def write_ports(layout: Layout, p: Vector, ports: Sequence[MotorPort], state: Vector, out: Vector) -> None:
    """Feedback from the columns of `kernel.observe` to the ports, exact (without sensors)."""
    motors, rows, states = layout.motors, layout.motor_rows(p), layout.motor_states(state)
    for j, port in enumerate(ports):
        rad_per_m = float(rows[j, lay.M_RAD_PER_M])
        port.position_rad = float(out[j]) * rad_per_m
        port.velocity_rad_s = float(out[motors + j]) * rad_per_m
        port.torque_Nm = float(out[2 * motors + j])
        port.reference = float(states[j, lay.SM_REFERENCE])
        port.torque_limited = bool(states[j, lay.SM_LIMITED])
