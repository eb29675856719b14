"""Machine and virtual I/O of the twin in the arrays of the fast path (`twin.machines.machine.VectorMachine`)."""

from __future__ import annotations

from collections.abc import Sequence

from hilbench.compiled import of_record
from hilbench.cycle_program import CompiledStage, python_stage
from hilbench.fast_path import layout as lay
from hilbench.fast_path.motors import Motors
from hilbench.fast_path.tables import NO_SLOT, FastPathRefusedError, Slots
from hilbench.twin.axis_listener import AxisListener
from hilbench.twin.machines.machine import MachineVectors
from hilbench.twin.process import TwinApplication


class TwinInArrays:
    """Twin part of a fast-path cycle, apart from the frames; `slots` are at its side. Call `join` before the first
    cycle."""

    def __init__(self, application: TwinApplication, slots: Slots) -> None:
        """Raises FastPathRefusedError where inputs or outputs of the machine are not in the arrays."""
        self._application, self._slots, self._cells = application, slots, slots.cells[slots.side]
        io = application.io
        real = [slots.of(cell, is_float=True) for cell in (*io.published_cells, *io.boundary_cells.values())]
        whole = [slots.of(cell) for cell in io.status_cells]
        known = {(slot, is_float) for _, slot, is_float in self._cells}
        if not {(slot, True) for slot in real} | {(slot, False) for slot in whole} <= known:
            raise FastPathRefusedError
        self._by_python = python_stage(self._go_on)

    def join(
        self, rows: lay.Rows, whole: lay.Whole, real: lay.Real, asked: lay.Real, shown: lay.Real, measured: lay.Real
    ) -> None:
        """Use these arrays: rows, set points (N,) and feedback (5 N,) of the virtual axes, and the measurement
        of the real ones, (4 N,)."""
        application, place = self._application, self._slots.of_cells
        on_these = rows, whole, real, asked, shown
        self._motors = Motors(application.drives, *on_these, None, application.cycle_s, self._cells, alone=True)
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
        return not (self._motors.over or self._application.leaves_vectors)

    @property
    def piece(self) -> CompiledStage:
        """Stage of a cycle: the machine's, or Python's while there are reports to be sent."""
        return self._application.in_vectors or self._by_python

    def _go_on(self) -> bool:
        """Run the cycle in Python; False if the next one needs the interpreter."""
        self._application.go_on_in_vectors()
        return not self._application.device.outbox and self.stays()

    def publish_by_objects(self) -> None:
        """Publish by the objects: a virtual axis has left the fast path."""
        self._motors.publish_by_objects()

    def give(self, *, awaits: bool = False) -> None:
        """Write the arrays back to the objects; `awaits`: the axes have not answered the last SYNC yet."""
        self._motors.give()
        if awaits:
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
