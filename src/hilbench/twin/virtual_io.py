"""Node 32: the twin's process data as a CiA-401 device with REAL32 analogue inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag

from hilbench.canopen.device import Device
from hilbench.canopen.object_store import Cell
from hilbench.topology.process_data.table import ProcessData

_STATUS = 0x2100  #: manufacturer specific: of which SYNC the process data are, and whether they can be trusted
_SYNCHRONIZER = 0x2101
_FOUND = 0x2103  #: errors of the model, as JSON
_MODEL = 0x2102  #: effects in the place of those that the model was configured with


class TwinStatus(IntFlag):
    """Bits of 2100h sub 3."""

    RUNNING = 1  #: the machine is released and simulated
    SYNCHRONIZED = 2  #: the deviation of the estimate is within the config's limit, and nothing is wrong
    HOLDING = 4  #: the measurement can't be used: the estimate is held (EMCY says why)
    LATE = 8  #: further SYNCs are waiting already
    TRANSFER_REFUSED = 16  #: a measured state was not plausible and was not taken over
    NOT_SEPARABLE = 32  #: the data don't tell what is estimated apart: it is held
    MODEL_CHANGING = 64  #: a changed model runs beside the one in use, or is being taken over
    MODEL_CHANGED = 128  #: the model in use has other effects than the configured one


#: The same as plain numbers, for what is compiled or runs in each cycle.
RUNNING, SYNCHRONIZED, HOLDING, LATE, TRANSFER_REFUSED, NOT_SEPARABLE, MODEL_CHANGING, MODEL_CHANGED = map(
    int, TwinStatus
)


class VirtualIo:
    """Access to the analogue inputs and outputs of the virtual I/O, as `data` has them.

    `boundary`: what the outputs hold before anybody writes them, by signal.
    """

    def __init__(self, device: Device, data: ProcessData, boundary: Mapping[str, float]) -> None:
        self._published = [device.cell(signal.index, signal.sub) for signal in data.published]
        self._boundary_inputs = {signal.name: device.cell(signal.index, signal.sub) for signal in data.boundary_inputs}
        self._sync_number = device.cell(_STATUS, 1)
        self._age = device.cell(_STATUS, 2)
        self._status = device.cell(_STATUS, 3)
        self._method = device.cell(_SYNCHRONIZER, 1)
        self._effects = device.cell(_MODEL, 1) if device.has(_MODEL, 1) else None
        self._step = device.cell(_MODEL, 2) if device.has(_MODEL, 2) else None
        self._found = device.cell(_FOUND, 1) if device.has(_FOUND, 1) else None
        self._names = [signal.name for signal in data.published]
        self._boundary = boundary
        self.reset_boundary_inputs()

    def reset_boundary_inputs(self) -> None:
        """Nobody has written the outputs yet."""
        for name, value in self._boundary.items():
            self._boundary_inputs[name].value = value

    @property
    def published_cells(self) -> Sequence[Cell]:
        """What is published: the objects of 6403h, in the order of `ProcessData.published`."""
        return self._published

    @property
    def boundary_cells(self) -> Mapping[str, Cell]:
        """What the bench says: the objects of 6413h by signal."""
        return self._boundary_inputs

    @property
    def status_cells(self) -> tuple[Cell, Cell, Cell]:
        """Number of the SYNC, age and status (2100h)."""
        return self._sync_number, self._age, self._status

    def publish(self, values: Sequence[float]) -> None:
        """Set what the next TPDOs carry: a value for each signal of 6403h, in the order of `ProcessData.published`."""
        for cell, value in zip(self._published, values, strict=True):
            cell.value = value

    def publish_status(self, sync_number: int, age_cycles: int, status: int) -> None:
        """For which SYNC since NMT start the data are, how many more were waiting, and the bits of `TwinStatus`."""
        self._sync_number.value = sync_number & 0xFFFF
        self._age.value = min(age_cycles, 0xFF)
        self._status.value = status

    def on_method(self, act: Callable[[int], None]) -> None:
        """Call `act` with the number of the method that is written (0: as configured)."""
        self._method.on_write = act

    def on_model(self, act: Callable[[str], None], steps: Callable[[], Sequence[float]]) -> None:
        """Call `act` with the effects (JSON, a list; empty: as configured) that are written into the model (2102h);
        `steps`: of each published value the largest step that the last change has made."""
        if self._effects is None or self._step is None:
            return
        self._effects.on_write = act
        tensions = [place for place, name in enumerate(self._names) if name.startswith("F")]
        self._step.on_read = lambda: max((steps()[place] for place in tensions if steps()), default=0.0)

    def on_found(self, report: Callable[[], str]) -> None:
        """What is read as that which was found of the machine beside what is followed (2103h)."""
        if self._found is not None:
            self._found.on_read = report

    def boundary_inputs(self, name: str) -> float:
        """A signal of the boundary, as the bench last said."""
        return float(self._boundary_inputs[name].value)
