"""Rows of `layout`, made from the objects of a bench and its devices."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hilbench.can import wire
from hilbench.canopen.data_types import DataType
from hilbench.canopen.object_store import Cell
from hilbench.canopen.pdo import PdoMap
from hilbench.cia402 import objects
from hilbench.cia402.drive import Drive
from hilbench.cia402.units import RPM
from hilbench.compiled import of_record
from hilbench.exchange.frame_tap import LineTap
from hilbench.fast_path import kernel
from hilbench.fast_path import layout as lay
from hilbench.plant.motor_port import FEEDBACK_SIZE, MotorMode

if TYPE_CHECKING:
    from hilbench.cia402.simulated import SimulatedDrive  # a bench without devices does not load them

NO_SLOT = -1
_EVERY = (lay.FRAME.names or ()).index("every")


class FastPathRefusedError(Exception):
    """Something of the bench is of a kind that only the interpreted cycle knows."""


def refuse_if(misfit: object) -> None:
    """Raise FastPathRefusedError where something does not fit the fast path."""
    if misfit:
        raise FastPathRefusedError


@dataclass
class Slots:
    """Slots of values: one for each cell of the devices' objects, and others."""

    whole: list[int] = field(default_factory=list)
    real: list[float] = field(default_factory=list)
    of_cells: dict[int, int] = field(default_factory=dict)  #: by id of the cell
    #: Each with its slot, true if that is a real one: of the hardware, and of the twin.
    cells: tuple[list[tuple[Cell, int, bool]], ...] = field(default_factory=lambda: ([], []))
    side: int = 0  #: whose cells are entered now: place among these

    def new(self, is_float: bool) -> int:
        """Make a slot that belongs to no object."""
        values: list[Any] = self.real if is_float else self.whole
        values.append(0)
        return len(values) - 1

    def of(self, cell: Cell, is_float: bool = False) -> int:
        """Slot of an object's cell, with its value. Raises FastPathRefusedError if that is no number."""
        known = self.of_cells.get(id(cell))
        if known is not None:
            return known
        if not isinstance(cell.value, int | float):
            raise FastPathRefusedError
        slot = self.new(is_float)
        if is_float:
            self.real[slot] = float(cell.value)
        else:
            self.whole[slot] = int(cell.value)
        self.of_cells[id(cell)] = slot
        self.cells[self.side].append((cell, slot, is_float))
        return slot


@dataclass
class Frames:
    """Frames of a cycle, with the slots of their contents."""

    rows: list[tuple[Any, ...]] = field(default_factory=list)
    sent: list[tuple[int, ...]] = field(default_factory=list)
    received: list[tuple[int, ...]] = field(default_factory=list)
    cob_ids: list[int] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    constants: dict[int, bytes] = field(default_factory=dict)  #: data of frames that are always the same

    def add(self, cob_id: int, part: int, content: PdoMap | bytes, slots: Sequence[int] = (), **timing: int) -> int:
        """Add a frame after the others; returns its row. `timing`: fields of `layout.FRAME`; without one it is sent in
        each cycle."""
        row, first = len(self.rows), len(self.sent)
        if isinstance(content, PdoMap):
            size = content.size
            self.sent += _fields(row, content, slots)
        else:
            size = len(content)
            self.constants[row] = content
        crc, stuffing, bits = wire.header(cob_id, size)
        fixed = {"cob_id": cob_id, "size": size, "part": part, "crc": crc, "stuffing": stuffing, "bits": bits}
        values = {"every": 1} | timing | fixed
        self.rows.append(of_record(lay.FRAME, first_sent=first, last_sent=len(self.sent), **values))
        self.cob_ids.append(cob_id)
        self.sizes.append(size)
        return row

    def take(self, row: int, content: PdoMap, slots: Sequence[int]) -> None:
        """Take a frame's content into these slots. Raises FastPathRefusedError where its length differs."""
        refuse_if(content.size != self.sizes[row])
        self.received += _fields(row, content, slots)

    def row_of(self, cob_id: int) -> int:
        """The row of an identifier. Raises FastPathRefusedError for one that is not sent."""
        refuse_if(cob_id not in self.cob_ids)
        return self.cob_ids.index(cob_id)

    def every(self, row: int) -> int:
        """Cycles from one such frame to the next."""
        return int(self.rows[row][_EVERY])


def new_image(
    frames: Frames,
    slots: Slots,
    *,
    tap: LineTap | None = None,
    cycles: int = 0,
    targets: Sequence[tuple[Any, ...]] = (),
    drives: Sequence[tuple[Any, ...]] = (),
    seen: Sequence[tuple[Any, ...]] = (),
    **more: Any,
) -> kernel.Image:
    """Process image of frames and slots, with rows of set points, of simulated drives and of those that are seen, and
    `more` arrays; `tap` gets the lines of `cycles` cycles at once."""
    rows, data = np.array(frames.rows, lay.FRAME), np.zeros((len(frames.rows), 8), np.uint8)
    received, every_row = np.array(sorted(frames.received), lay.FIELD), range(len(frames.rows))
    for name, side in (("first_received", "left"), ("last_received", "right")):
        rows[name] = np.searchsorted(received["frame"], every_row, side)  # type: ignore[call-overload]
    for row, content in frames.constants.items():
        data[row, : len(content)] = np.frombuffer(content, np.uint8)
    heads = b""
    for each in rows if tap is not None else ():
        head = tap.head(int(each["cob_id"])).encode("ascii", "backslashreplace") if tap is not None else b""
        each["head"], each["head_end"] = len(heads), len(heads) + len(head)
        heads += head
    return kernel.Image(
        frames=rows,
        sent=np.array(frames.sent, lay.FIELD),
        received=received,
        data=data.reshape(-1),
        order=np.zeros(len(rows), np.int64),
        whole=np.array([*slots.whole, 0], np.int64),
        real=np.array([*slots.real, 0.0]),
        given=np.zeros(1, lay.GIVEN),
        left=np.zeros(1, lay.LEFT),
        clocks=np.zeros(2, np.int64),
        scratch=np.zeros(1),
        heads=np.array(list(heads), np.uint8),
        text=np.zeros(cycles * (len(rows) * lay.LINE + len(heads)) if tap is not None else 0, np.uint8),
        targets=np.array([*targets], lay.TARGET),
        set_points=np.zeros(len(targets)),
        drives=np.array([*drives], lay.DRIVE),
        asked=np.zeros(len(drives)),
        shown=np.zeros(FEEDBACK_SIZE * len(drives)),
        seen=np.array([*seen], lay.FEEDBACK),
        feedback=np.zeros(4 * len(seen)),
        **more,
    )


def sent_data(image: kernel.Image, row: int, size: int) -> bytes:
    """Data of a frame as it was on the wire last."""
    return bytes(image.data[8 * row : 8 * row + size])


def _fields(row: int, content: PdoMap, slots: Sequence[int]) -> list[tuple[int, ...]]:
    fields: list[tuple[int, ...]] = []
    offset = 0
    for kind, slot in zip(content.kinds, slots, strict=True):
        width = kind.width or 0
        is_of = lay.FLOAT if kind.is_float else lay.SIGNED if kind.is_signed else lay.UNSIGNED
        if kind is DataType.BOOLEAN or (is_of == lay.UNSIGNED and width == 8):
            raise FastPathRefusedError  # less than a byte; no signed number of 64 bits holds it
        fields.append((row, slot, offset, width, is_of))
        offset += width
    return fields


def cell_slots(slots: Slots, content: PdoMap, cells: Iterable[Cell]) -> list[int]:
    """Slots of mapped objects."""
    return [slots.of(cell, kind.is_float) for cell, kind in zip(cells, content.kinds, strict=True)]


def new_slots(slots: Slots, content: PdoMap) -> list[int]:
    """New slots for the contents of a PDO."""
    return [slots.new(kind.is_float) for kind in content.kinds]


def drive_row(drive: SimulatedDrive, slots: Slots) -> tuple[Any, ...]:
    """A simulated drive that follows its set point."""
    firmware, port = drive.firmware, drive.firmware.port
    units, velocity = firmware.units, port.mode is MotorMode.VELOCITY
    target = firmware.target_velocity if velocity else firmware.target_torque
    offset = firmware.velocity_offset if velocity else firmware.torque_offset
    return of_record(
        lay.DRIVE,
        velocity=velocity,
        target=slots.of(target),
        offset=slots.of(offset),
        set_point_unit=units.velocity_rad_s if velocity else units.torque_Nm,
        limit=firmware.velocity_limit_rad_s if velocity else firmware.torque_limit_Nm,
        set_point=port.setpoint,
        limited=drive.mode.limited,
        position_rad=units.position_rad,
        velocity_rad_s=units.velocity_rad_s,
        torque_Nm=units.torque_Nm,
        vl_rad_s=RPM,
        overspeed_rad_s=firmware.overspeed_rad_s,
        origin=firmware.position_origin,
        count=firmware.encoder_count,
        position=slots.of(firmware.position_actual),
        speed=slots.of(firmware.velocity_actual),
        torque=slots.of(firmware.torque_actual),
        vl=slots.of(firmware.vl_actual) if firmware.shows_vl else NO_SLOT,
        position_demand=slots.of(firmware.position_demand),
        velocity_demand=slots.of(firmware.velocity_demand),
        torque_demand=slots.of(firmware.torque_demand),
        statusword=slots.of(drive.statusword),
        bits=drive.following_bits,
    )


def feedback_row(drive: Drive, raw: dict[int, int]) -> tuple[Any, ...]:
    """A drive as the bench sees it; `raw`: slots by the index of the object. Raises FastPathRefusedError."""
    missing = {objects.STATUSWORD, objects.TORQUE_ACTUAL_VALUE, objects.POSITION_ACTUAL_VALUE} - set(raw)
    if missing or drive.counter.value is None:
        raise FastPathRefusedError
    units, feedback = drive.units, drive.feedback
    return of_record(
        lay.FEEDBACK,
        position=raw[objects.POSITION_ACTUAL_VALUE],
        speed=raw.get(objects.VELOCITY_ACTUAL_VALUE, NO_SLOT),
        torque=raw[objects.TORQUE_ACTUAL_VALUE],
        statusword=raw[objects.STATUSWORD],
        value=drive.counter.value,
        last=drive.counter.last,
        position_rad=units.position_rad,
        velocity_rad_s=units.velocity_rad_s,
        torque_Nm=units.torque_Nm,
        before_rad=feedback.position_rad,
        period_s=drive.tpdo_period_s,
        by_difference=not drive.settings.has_velocity,
    )


def reals(vector: lay.Real) -> memoryview[float]:
    """View of the vector as a memoryview: access to single numbers is faster than through the array."""
    return vector.data.cast("B").cast("d")
