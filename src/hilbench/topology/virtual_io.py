"""The process data of the virtual I/O: which signal is which REAL32 of the CiA-401 device, in which PDO.

One table for each kind of machine; the bench's maps, the twin's objects and the EDS file go by it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

from hilbench.plant.effects import MachineKind

#: CiA 401: read analogue input float, what the twin publishes; write analogue output float, what it is sent.
INPUTS: Final = 0x6403
OUTPUTS: Final = 0x6413


class IoPdo(StrEnum):
    """The PDOs of the virtual I/O that carry process data."""

    STATE = "state"  #: TPDO1, with every SYNC
    QUALITY = "quality"  #: TPDO2, with every tenth SYNC
    BOUNDARY = "boundary"  #: RPDO1


@dataclass(frozen=True, slots=True)
class IoSignal:
    """One value: the signal by its name, its object, and the PDO that carries it (None: read by SDO only)."""

    name: str
    index: int
    sub: int
    pdo: IoPdo | None


@dataclass(frozen=True, slots=True)
class ProcessData:
    """What goes between the bench and the twin of one kind of machine.

    The simulated torque is in no PDO: it is the measured one of the last axis minus the residual.
    """

    signals: tuple[IoSignal, ...]
    simulated_torque: str  #: name of its signal
    residual: str  #: name of the signal of the residual of that torque

    def of(self, index: int) -> tuple[IoSignal, ...]:
        """The signals of 6403h or 6413h, by sub-index."""
        return tuple(signal for signal in self.signals if signal.index == index)

    def carried_by(self, pdo: IoPdo) -> tuple[IoSignal, ...]:
        """The signals of a PDO, in its order."""
        return tuple(signal for signal in self.signals if signal.pdo is pdo)


PROCESS_DATA: Final[Mapping[MachineKind, ProcessData]] = {
    MachineKind.WEB_LINE: ProcessData(
        (
            IoSignal("F_sim_N", INPUTS, 1, IoPdo.STATE),
            IoSignal("E_sim_Pa", INPUTS, 2, IoPdo.STATE),
            IoSignal("E_sd_Pa", INPUTS, 3, IoPdo.QUALITY),
            IoSignal("tau2_sim_Nm", INPUTS, 4, None),
            IoSignal("tau2_residual_Nm", INPUTS, 5, IoPdo.QUALITY),
            IoSignal("strain_prev", OUTPUTS, 1, IoPdo.BOUNDARY),
            IoSignal("F_next_N", OUTPUTS, 2, IoPdo.BOUNDARY),
        ),
        simulated_torque="tau2_sim_Nm",
        residual="tau2_residual_Nm",
    ),
    MachineKind.SERVO_AXIS: ProcessData(
        (
            IoSignal("J_sim_kg_m2", INPUTS, 1, IoPdo.STATE),
            IoSignal("coulomb_sim_Nm", INPUTS, 2, IoPdo.STATE),
            IoSignal("J_sd_kg_m2", INPUTS, 3, IoPdo.QUALITY),
            IoSignal("tau1_sim_Nm", INPUTS, 4, None),
            IoSignal("tau1_residual_Nm", INPUTS, 5, IoPdo.QUALITY),
        ),
        simulated_torque="tau1_sim_Nm",
        residual="tau1_residual_Nm",
    ),
}
