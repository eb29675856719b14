"""The process data of a machine; the bench's maps, the twin's objects and the EDS files go by it."""

from __future__ import annotations

from hilbench.plant.effect import MachineKind
from hilbench.topology.process_data import servo_axis, web_line
from hilbench.topology.process_data.table import ProcessData
from hilbench.topology.signals import Shape


def process_data(kind: MachineKind, shape: Shape) -> ProcessData:
    """Process data between the bench and the twin of a machine."""
    return servo_axis.process_data() if kind is MachineKind.SERVO_AXIS else web_line.process_data(shape)
