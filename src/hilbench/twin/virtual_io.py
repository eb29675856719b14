"""Node 32: the twin's process data as a CiA-401 device with REAL32 analogue inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntFlag

from hilbench.canopen.device import Device

_INPUTS = 0x6403  #: read analogue input float: what the twin tells
_OUTPUTS = 0x6413  #: write analogue output float: what the twin is told
_STATUS = 0x2100  #: manufacturer specific: of which SYNC the process data are, and whether they can be trusted
_SYNCHRONIZER = 0x2101


class TwinStatus(IntFlag):
    """Bits of 2100h sub 3."""

    RUNNING = 1  #: the web is released and simulated
    SYNCHRONIZED = 2  #: the deviation of E is within the config's limit, and nothing is wrong
    HOLDING = 4  #: the measurement can't be used: E is held (EMCY says why)
    LATE = 8  #: further SYNCs are waiting already
    TRANSFER_REFUSED = 16  #: a measured state was not plausible and was not taken over
    NOT_SEPARABLE = 32  #: the data don't tell a parameter from E: it is held


class VirtualIo:
    """Named access to the analogue inputs and outputs of the virtual I/O."""

    def __init__(self, device: Device, *, strain_prev: float, tension_next_N: float) -> None:
        self._tension_N = device.cell(_INPUTS, 1)
        self._modulus_Pa = device.cell(_INPUTS, 2)
        self._deviation_Pa = device.cell(_INPUTS, 3)
        self._torque_Nm = device.cell(_INPUTS, 4)
        self._residual_Nm = device.cell(_INPUTS, 5)
        self._strain_prev = device.cell(_OUTPUTS, 1)
        self._tension_next_N = device.cell(_OUTPUTS, 2)
        self._sync_number = device.cell(_STATUS, 1)
        self._age = device.cell(_STATUS, 2)
        self._status = device.cell(_STATUS, 3)
        self._method = device.cell(_SYNCHRONIZER, 1)
        self._strain_prev.value = strain_prev
        self._tension_next_N.value = tension_next_N

    def tell(
        self, *, tension_N: float, modulus_Pa: float, deviation_Pa: float, torque_Nm: float, residual_Nm: float
    ) -> None:
        """Set what the next TPDOs carry."""
        self._tension_N.value = tension_N
        self._modulus_Pa.value = modulus_Pa
        self._deviation_Pa.value = deviation_Pa
        self._torque_Nm.value = torque_Nm
        self._residual_Nm.value = residual_Nm

    def publish_status(self, sync_number: int, age_cycles: int, status: int) -> None:
        """For which SYNC since NMT start the data are, how many more were waiting, and the bits of `TwinStatus`."""
        self._sync_number.value = sync_number & 0xFFFF
        self._age.value = min(age_cycles, 0xFF)
        self._status.value = status

    def on_method(self, act: Callable[[int], None]) -> None:
        """Call `act` with the number of the method that is written (0: as configured)."""
        self._method.on_write = act

    @property
    def strain_prev(self) -> float:
        """Upstream strain, as the bench last said."""
        return float(self._strain_prev.value)

    @property
    def tension_next_N(self) -> float:
        """Downstream tension in N, as the bench last said."""
        return float(self._tension_next_N.value)
