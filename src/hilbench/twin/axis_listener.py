"""Receiver of a real axis's TPDO1: position and torque at the motor, in SI."""

from __future__ import annotations

from hilbench.cia402 import objects
from hilbench.cia402.axis import mapped_objects
from hilbench.cia402.configuration import DriveSettings, drive_pdos
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.units import UnwrappingCounter
from hilbench.exchange.addressing import declared_units, dictionary_of
from hilbench.topology.parts import Part


class AxisListener:
    """Decoder of the TPDO1 of one real axis by its EDS."""

    def __init__(self, axis: Part, cycle_s: float) -> None:
        node_id = axis.node.node_id
        mode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
        settings = DriveSettings(f"axis of node {node_id}", node_id, mode, cycle_s, axis=axis.node_axis)
        self.pdo = pdo = drive_pdos(settings, dictionary_of(axis)).tpdos[0]
        self.cob_id = pdo.cob_id
        self.size = pdo.size  #: bytes of the frame's data
        indices = mapped_objects(pdo)
        self.position = indices.index(objects.POSITION_ACTUAL_VALUE)  #: index in the PDO, as the next
        self.torque = indices.index(objects.TORQUE_ACTUAL_VALUE)
        self.units = declared_units(axis)
        self.counter = UnwrappingCounter()

    def decode(self, data: bytes) -> tuple[float, float]:
        """Position in rad, unwrapped, and torque in N·m; `data` of `size` bytes."""
        values = self.pdo.unpack(data)
        position = self.counter.update(int(values[self.position])) * self.units.position_rad
        return position, float(values[self.torque]) * self.units.torque_Nm
