"""Drives of a host that follow, with their motors and what these turn: the part of a plain cycle that is no frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hilbench.batch import kernel
from hilbench.batch import layout as lay
from hilbench.canopen.object_store import Cell
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.plant.interface import Steps, StepsInModes


class Motors:
    """Drives by their rows (D,) of `layout.DRIVE`, whose objects are in the slots of `whole` and `real`.

    `turned`: what their motors turn, so far with each cycle (`step_s`); `alone`: it has no other motors; `cells`: the
    drives' objects, each with its slot and whether that is a real one; `shows_ports`: somebody looks at the ports in
    every cycle.
    """

    def __init__(
        self,
        drives: Sequence[SimulatedDrive],
        rows: lay.Rows,
        whole: lay.Whole,
        real: lay.Real,
        turned: Steps,
        step_s: float,
        cells: Sequence[tuple[Cell, int, bool]],
        *,
        alone: bool,
        shows_ports: bool,
    ) -> None:
        self.over = False  #: the objects know more than the arrays
        self._drives, self._rows, self._cells = drives, rows, cells
        self._whole, self._real = whole, real
        self._turned = turned
        self._step_s = step_s
        self._ports = [drive.firmware.port for drive in drives]
        self._shows_ports = shows_ports
        self._set_points = rows["set_point"]
        self._asked = np.zeros(len(drives))
        self._shown = np.zeros(lay.PORT_SIZE * len(drives))
        self._step: Callable[[], None] | None = None
        if alone and isinstance(turned, StepsInModes):
            self._step = turned.steps_in_modes(self._asked, step_s, self._shown)

    def move(self) -> None:
        """Take the set points, go on, and show the feedback."""
        if self._step is not None:
            self._asked[:] = self._set_points
            self._step()
            if self._shows_ports:
                self._give_ports()
        else:
            self._move_by_ports()
        if not kernel.publish(self._rows, self._shown, self._whole):
            self.give()
            self.over = True
            for drive in self._drives:
                drive.publish()

    def _move_by_ports(self) -> None:
        for port, set_point in zip(self._ports, self._set_points.tolist(), strict=True):
            port.setpoint = set_point
        self._turned.step(self._step_s)
        values: list[float] = []
        for port in self._ports:
            values += (port.position_rad, port.velocity_rad_s, port.torque_Nm, port.reference, port.torque_limited)
        self._shown[:] = values

    def _give_ports(self) -> None:
        values = self._shown.tolist()
        for at, (port, set_point) in enumerate(zip(self._ports, self._asked.tolist(), strict=True)):
            port.setpoint = set_point
            shown = values[lay.PORT_SIZE * at : lay.PORT_SIZE * (at + 1)]
            port.position_rad, port.velocity_rad_s, port.torque_Nm, port.reference, limited = shown
            port.torque_limited = limited != 0.0

    def give(self) -> None:
        """The objects, the drives and their ports get what the arrays have."""
        if self.over:
            return
        if self._step is not None:
            self._asked[:] = self._set_points
            self._give_ports()
        whole, real = self._whole.tolist(), self._real.tolist()
        for cell, slot, is_float in self._cells:
            cell.value = real[slot] if is_float else whole[slot]
        for drive, row in zip(self._drives, self._rows, strict=True):
            drive.published_until(int(row["count"]), limited=bool(row["limited"]))
