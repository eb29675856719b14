"""Following drives of a host, with their motors and the rig: the part of a fast-path cycle that is no frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from hilbench.canopen.object_store import Cell
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.fast_path import layout as lay
from hilbench.plant.interface import Steps, StepsInModes
from hilbench.plant.motor_port import FEEDBACK_SIZE


class Motors:
    """Drives by their rows (D,) of `layout.DRIVE`, whose objects are in the slots of `whole` and `real`.

    `asked` (D,): the set points that they follow; `shown`, (D · 5,): the values of their ports; `turned`: the
    rig that they turn, by `step_s` each cycle (None: it is stepped elsewhere); `alone`: it has no other motors;
    `cells`: the drives' objects, each with its slot and whether that is a real one.
    """

    def __init__(
        self,
        drives: Sequence[SimulatedDrive],
        rows: lay.Rows,
        whole: lay.Whole,
        real: lay.Real,
        asked: lay.Real,
        shown: lay.Real,
        turned: Steps | None,
        step_s: float,
        cells: Sequence[tuple[Cell, int, bool]],
        *,
        alone: bool,
    ) -> None:
        self.over = False  #: the objects know more than the arrays
        self._drives, self._rows, self._cells = drives, rows, cells
        self._whole, self._real = whole, real
        self._asked, self._shown = asked, shown
        self._ports = [drive.firmware.port for drive in drives]
        self._asked[:] = rows["set_point"]
        self._shown.reshape(-1, FEEDBACK_SIZE)[:] = [port.feedback for port in self._ports]
        self._turned, self._alone = turned, alone
        self._keeps_ports = turned is not None
        #: Take the set points and step; a compiled stage where the ports are not read meanwhile.
        self.step: Callable[[], object] = self._step_of(step_s)

    def _step_of(self, step_s: float) -> Callable[[], object]:
        turned = self._turned
        if self._alone and isinstance(turned, StepsInModes):
            step = turned.steps_in_modes(self._asked, step_s, self._shown)
            if step is not None:
                self._keeps_ports = False
                return step
        return partial(self._step_by_ports, step_s)

    def _step_by_ports(self, step_s: float) -> None:
        assert self._turned is not None, "somebody else's"
        for port, set_point in zip(self._ports, self._asked.tolist(), strict=True):
            port.setpoint = set_point
        self._turned.step(step_s)
        self._shown.reshape(-1, FEEDBACK_SIZE)[:] = [port.feedback for port in self._ports]

    def _give_ports(self) -> None:
        shown = self._shown.reshape(-1, FEEDBACK_SIZE).tolist()
        for port, set_point, of_port in zip(self._ports, self._asked.tolist(), shown, strict=True):
            port.setpoint, port.feedback = set_point, of_port

    def publish_by_objects(self) -> None:
        """Hand the drives back to their objects: one can't continue as it was."""
        self.give()
        self.over = True
        for drive in self._drives:
            drive.publish()

    def give(self) -> None:
        """The objects, the drives and their ports get what the arrays have."""
        if self.over:
            return
        if not self._keeps_ports:
            self._give_ports()
        whole, real = self._whole.tolist(), self._real.tolist()
        for cell, slot, is_float in self._cells:
            cell.value = real[slot] if is_float else whole[slot]
        for drive, row in zip(self._drives, self._rows, strict=True):
            drive.published_until(int(row["count"]), limited=bool(row["limited"]))
