"""Node 32: the twin's process data as a CiA-401 device with REAL32 analogue inputs and outputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from enum import IntFlag

from hilbench.canopen.device import Device
from hilbench.topology.process_data.table import ProcessData

_STATUS = 0x2100  #: manufacturer specific: SYNC number of the process data, and their status
_SYNCHRONIZER = 0x2101
_FOUND = 0x2103  #: errors of the model, as JSON
_MODEL = 0x2102  #: effects in place of the configured ones


class TwinStatus(IntFlag):
    """Bits of 2100h sub 3."""

    RUNNING = 1  #: the machine is released and simulated
    SYNCHRONIZED = 2  #: the deviation of the estimate is within the config's limit, without problem
    HOLDING = 4  #: the measurement is unusable: the estimate is held (reason by EMCY)
    LATE = 8  #: further SYNCs are waiting already
    TRANSFER_REFUSED = 16  #: a measured state was implausible and not transferred, or there was none for 0.25 s
    NOT_SEPARABLE = 32  #: the data don't separate all estimated parameters: they are held
    MODEL_CHANGING = 64  #: a changed model runs in parallel, or is being taken over
    MODEL_CHANGED = 128  #: the model in use has other effects than the configured one


#: Status bits as ints, for compiled and cyclic code.
RUNNING, SYNCHRONIZED, HOLDING, LATE, TRANSFER_REFUSED, NOT_SEPARABLE, MODEL_CHANGING, MODEL_CHANGED = map(
    int, TwinStatus
)


class VirtualIo:
    """Access to the analogue inputs and outputs of the virtual I/O, as of `data`.

    `boundary`: initial values of the outputs, by signal.
    """

    def __init__(self, device: Device, data: ProcessData, boundary: Mapping[str, float]) -> None:
        #: Published objects of 6403h, in the order of `ProcessData.published`.
        self.published_cells = [device.cell(signal.index, signal.sub) for signal in data.published]
        #: Boundary inputs: the objects of 6413h by signal.
        self.boundary_cells = {signal.name: device.cell(signal.index, signal.sub) for signal in data.boundary_inputs}
        #: SYNC number, age and status (2100h).
        self.status_cells = device.cell(_STATUS, 1), device.cell(_STATUS, 2), device.cell(_STATUS, 3)
        self._method = device.cell(_SYNCHRONIZER, 1)
        self._effects = device.cell(_MODEL, 1) if device.has(_MODEL, 1) else None
        self._step = device.cell(_MODEL, 2) if device.has(_MODEL, 2) else None
        self._found = device.cell(_FOUND, 1) if device.has(_FOUND, 1) else None
        self._names = [signal.name for signal in data.published]
        self._boundary = boundary
        self.reset_boundary_inputs()

    def reset_boundary_inputs(self) -> None:
        """Reset the outputs to their initial values."""
        for name, value in self._boundary.items():
            self.boundary_cells[name].value = value

    def publish(self, values: Sequence[float]) -> None:
        """Set the values of the next TPDOs: one for each signal of 6403h, in the order of `ProcessData.published`."""
        for cell, value in zip(self.published_cells, values, strict=True):
            cell.value = value

    def publish_status(self, sync_number: int, age_cycles: int, status: int) -> None:
        """Set SYNC number since NMT start, number of waiting SYNCs, and the bits of `TwinStatus`."""
        values = sync_number & 0xFFFF, min(age_cycles, 0xFF), status
        for cell, value in zip(self.status_cells, values, strict=True):
            cell.value = value

    def on_method(self, act: Callable[[int], None]) -> None:
        """Call `act` with the number of the method that is written (0: as configured)."""
        self._method.on_write = act

    def on_model(self, act: Callable[[str], None], steps: Callable[[], Sequence[float]]) -> None:
        """Call `act` with the effects (JSON list; empty: as configured) written to the model (2102h); `steps`: largest
        step of each published value by the last change."""
        if self._effects is None or self._step is None:
            return
        self._effects.on_write = act
        forces = [place for place, name in enumerate(self._names) if name.startswith("F")]
        self._step.on_read = lambda: max((steps()[place] for place in forces if steps()), default=0.0)

    def on_found(self, report: Callable[[], str]) -> None:
        """Set the source of the estimated model errors (2103h)."""
        if self._found is not None:
            self._found.on_read = report

    def boundary_inputs(self, name: str) -> float:
        """Boundary input by signal, as last stated by the bench."""
        return float(self.boundary_cells[name].value)
