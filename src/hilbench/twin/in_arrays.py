"""Machine and virtual I/O of the twin in the arrays of the fast path.

The machine is in vectors as well where it can be (`twin.machines.machine.VectorMachine`); else it and its outputs stay
objects, and of its virtual I/O only the PDOs are in the arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hilbench.canopen.object_store import Cell
from hilbench.compiled import of_record
from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.fast_path import layout as lay
from hilbench.fast_path.devices import HostFrames
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.tables import NO_SLOT, FastPathRefusedError, Slots, reals
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.machines.machine import MachineVectors
from hilbench.twin.process import TwinApplication

#: Fast-path cycles after which it is checked anew whether the machine can be in vectors.
_LOOK_FOR_VECTORS = 64


class TwinInArrays:
    """Twin part of a fast-path cycle, apart from the frames.

    `of_host`: its devices, with their process-image offsets (of the side that `slots` is at). Call `join` before the
    first cycle.
    """

    def __init__(self, application: TwinApplication, of_host: HostFrames, slots: Slots) -> None:
        """Raises FastPathRefusedError where the virtual I/O's objects are of another type than the twin's values."""
        self._application, self._slots, self._cells = application, slots, slots.cells[slots.side]
        self._in_vectors = application.runs_in_vectors
        self._read_real: list[tuple[Cell, int]] = []
        self._read_whole: list[tuple[Cell, int]] = []
        self._written: list[tuple[Cell, int]] = []
        self._of_io: set[int] = set()  # cells that hold their values themselves
        self._cycles = 0
        self._by_objects = python_stage(self._go_on_by_objects)
        if not self._in_vectors:
            self._find_cells(of_host)
            return
        # All inputs and outputs of the machine have to be in the arrays.
        io = application.io
        real = [slots.of(cell, is_float=True) for cell in (*io.published_cells, *io.boundary_cells.values())]
        whole = [slots.of(cell) for cell in io.status_cells]
        known = {(slot, is_float) for _, slot, is_float in self._cells}
        if not {(slot, True) for slot in real} | {(slot, False) for slot in whole} <= known:
            raise FastPathRefusedError

    def _find_cells(self, of_host: HostFrames) -> None:
        """Find the objects that its PDOs read and write."""
        device, places = self._application.device, {id(each[0]): each for each in self._cells}
        read = [places[id(cell)] for of, tpdo, _ in of_host.answering if of is device for cell in tpdo.cells]
        written = [places[id(cell)] for of, rpdo, _ in of_host.taken if of is device for cell in rpdo.cells]
        self._read_real = [(cell, slot) for cell, slot, is_float in read if is_float]
        self._read_whole = [(cell, slot) for cell, slot, is_float in read if not is_float]
        if not all(is_float for _, _, is_float in written):
            raise FastPathRefusedError
        self._written = [(cell, slot) for cell, slot, _ in written]
        self._of_io = {id(cell) for cell, _, _ in (*read, *written)}

    def join(
        self, rows: lay.Rows, whole: lay.Whole, real: lay.Real, asked: lay.Real, shown: lay.Real, measured: lay.Real
    ) -> None:
        """Use these arrays: rows, set points (N,) and feedback (N PORT_SIZE,) of the virtual axes, and the measurement
        of the real ones, (4 N,)."""
        application = self._application
        self._whole_at, self._real_at, self._measured = whole.data, reals(real), measured
        self._motors = Motors(
            application.drives,
            rows,
            *(whole, real, asked, shown),
            None if self._in_vectors else application.turned,
            application.cycle_s,
            [each for each in self._cells if id(each[0]) not in self._of_io],
            alone=True,
            shows_ports=True,
        )
        if not self._in_vectors:
            self._show_status()
            return
        place = self._slots.of_cells
        number, _, status = application.io.status_cells
        application.begin_in_vectors(
            MachineVectors(
                measured=measured,
                asked=asked,
                shown=shown,
                values=real,
                boundary_places={name: place[id(cell)] for name, cell in application.io.boundary_cells.items()},
                published=[place[id(cell)] for cell in application.io.published_cells],
                whole=whole,
                number=place[id(number)],
                status=place[id(status)],
            )
        )

    def stays(self) -> bool:
        """True if the next cycle can run in the arrays as this one did."""
        self._application.count_syncs()
        if self._motors.over or self._application.leaves_vectors:
            return False
        looks = not (self._in_vectors or (self._cycles + 1) % _LOOK_FOR_VECTORS)
        return not (looks and self._application.runs_in_vectors)

    @property
    def piece(self) -> CompiledStage:
        """Stage of a cycle, as `go_on`."""
        return (self._application.in_vectors if self._in_vectors else None) or self._by_objects

    def _show_status(self) -> None:
        """Write the content of the next SYNC's TPDOs into the arrays."""
        cells, values = self._application.io.status_cells, self._application.begin_fast_path()
        values_of: dict[int, Any] = {id(cell): value for cell, value in zip(cells, values, strict=True)}
        for cell, slot in self._read_real:
            self._real_at[slot] = cell.value
        for cell, slot in self._read_whole:
            value: Any = values_of.get(id(cell), cell.value)
            self._whole_at[slot] = value

    def go_on(self) -> None:
        """Run the cycle after the axes' answers to this SYNC."""
        self._cycles += 1
        if self._in_vectors:
            self._application.go_on_in_vectors()
            return
        self._give_boundary_inputs()
        values = self._measured.tolist()
        self._application.go_on(list(zip(values[::4], values[2::4], strict=True)), self._motors.step)
        self._show_status()

    def _go_on_by_objects(self) -> bool:
        """Run the cycle; False if the next one needs the interpreter."""
        self.go_on()
        return not self._application.device.outbox and self.stays()

    def _give_boundary_inputs(self) -> None:
        for cell, slot in self._written:
            cell.value = self._real_at[slot]

    def publish_by_objects(self) -> None:
        """Publish by the objects: a virtual axis has left the fast path."""
        self._motors.publish_by_objects()

    def leave(self) -> None:
        """Leave without an answered SYNC: the objects are up to date."""
        self._application.forget_vectors()

    def give(self, *, awaits: bool = False) -> None:
        """Write the arrays back to the objects; `awaits`: the axes have not answered the last SYNC yet."""
        self._motors.give()
        if awaits:
            self._give_boundary_inputs()
            self._application.awaits_measurements()
        self._application.end_in_vectors()


def received_row(listener: AxisListener, position: int, torque: int) -> tuple[float, ...]:
    """Row of `layout.FEEDBACK` for a real axis: offsets of position and torque. Raises FastPathRefusedError."""
    counter, units = listener.counter, listener.units
    if counter.value is None:
        raise FastPathRefusedError
    return of_record(
        lay.FEEDBACK,
        position=position,
        speed=NO_SLOT,
        torque=torque,
        statusword=position,  # a state is not looked for
        value=counter.value,
        last=counter.last,
        position_rad=units.position_rad,
        torque_Nm=units.torque_Nm,
        period_s=1.0,
    )


def give_counters(listeners: Sequence[AxisListener], seen: lay.Rows) -> None:
    """Write the unwrapping counters of the rows back to the listeners."""
    for listener, row in zip(listeners, seen, strict=True):
        listener.counter.counted_until(int(row["value"]), int(row["last"]))
