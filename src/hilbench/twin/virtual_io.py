"""Node 32: the twin's process data as a CiA-401 device with REAL32 analogue inputs and outputs."""

from __future__ import annotations

from hilbench.fieldbus.device import Device

_INPUTS = 0x6403  #: read analogue input float: what the twin tells
_OUTPUTS = 0x6413  #: write analogue output float: what the twin is told


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

    @property
    def strain_prev(self) -> float:
        """Upstream strain, as the bench last said."""
        return float(self._strain_prev.value)

    @property
    def tension_next_N(self) -> float:
        """Downstream tension in N, as the bench last said."""
        return float(self._tension_next_N.value)
