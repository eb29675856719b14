"""Receiver of a real axis's TPDO1: position and torque at the motor, in SI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hilbench.canopen.eds import shared_eds
from hilbench.cia402 import objects
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.configuration import DriveSettings, drive_pdos
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.units import DriveUnits, UnwrappingCounter


@dataclass(frozen=True)
class TwinNode:
    """Node of the twin, or one that it listens to."""

    node_id: int
    eds: Path


@dataclass(frozen=True)
class AxisNode(TwinNode):
    """Node of an axis, real or virtual, with its drive's units."""

    units: DriveUnits
    axis: int = 1  #: of its node


class AxisListener:
    """Decoder of the TPDO1 of one real axis by its EDS."""

    def __init__(self, axis: AxisNode, cycle_s: float) -> None:
        od, node_id = shared_eds(axis.eds, axis.node_id), axis.node_id
        mode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
        settings = DriveSettings(f"axis of node {node_id}", node_id, mode, cycle_s, axis=axis.axis)
        self.pdo = pdo = drive_pdos(settings, od).tpdos[0]
        self.cob_id = pdo.cob_id
        self.size = pdo.size  #: bytes of the frame's data
        indices = mapped_objects(pdo)
        self.position = indices.index(objects.POSITION_ACTUAL_VALUE)  #: index in the PDO, as the next
        self.torque = indices.index(objects.TORQUE_ACTUAL_VALUE)
        self.units = axis.units
        self.counter = UnwrappingCounter()

    def decode(self, data: bytes) -> tuple[float, float]:
        """Position in rad, unwrapped, and torque in N·m; `data` of `size` bytes."""
        values = self.pdo.unpack(data)
        position = self.counter.update(int(values[self.position])) * self.units.position_rad
        return position, float(values[self.torque]) * self.units.torque_Nm
