"""Measurements of drives and twin from cycle to cycle, written into a sample by compiled code on vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    COUNT,
    TABLE,
    TABLE_WIDTH,
    compiled,
    entry_point,
    floats,
    integers,
    table_of,
)
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.topology.sample import CycleSample

Vector = NDArray[np.float64]
Whole = NDArray[np.int64]

#: Of a drive in what is measured: position, velocity, torque (SI), statusword.
POSITION, VELOCITY, TORQUE, STATUSWORD, OF_DRIVE = range(5)
#: Columns of a simulated torque: place of the measured one, its own place and that of its residual in the twin's
#: signals, and the TPDO that carries it.
_MEASURED, _SIMULATED, _RESIDUAL, _BROUGHT_BY, _OF_TORQUE = range(5)
_NOWHERE = -1
#: What is counted: cycles, and bits on the bus in the last one; the SYNC that the twin has answered last, by its count,
#: and its status (bits of `TwinStatus`).
CYCLES, BITS, TWIN_SYNC, TWIN_STATUS, _COUNTED = range(5)


@compiled
def take_twin(came: Whole, torques: Whole, before_Nm: Vector, of_drives: Vector, virtual_io: Vector) -> None:
    """Update simulated torques from their residuals after a cycle in which these TPDOs of the twin `came` (P,).

    The residual is that of the cycle before: the twin compared after this cycle's TPDO was due.
    """
    for k in range(len(before_Nm)):
        row = torques[k * _OF_TORQUE : (k + 1) * _OF_TORQUE]
        if came[row[_BROUGHT_BY]] != 0:
            virtual_io[row[_SIMULATED]] = before_Nm[k] - virtual_io[row[_RESIDUAL]]
        before_Nm[k] = of_drives[row[_MEASURED]]


@compiled
def twin_age_cycles(syncs: int, twin_sync: int) -> int:
    """Age in cycles of the twin's last answer, from the 16-bit SYNC counters of bench and twin."""
    # Started while SYNCs were running it may have counted one or two more than the bench.
    age = ((syncs - twin_sync + 0x8000) & 0xFFFF) - 0x8000
    return age if age > 0 else 0


@entry_point(TABLE)
def _take(table: NDArray[np.int64]) -> None:
    if len(table) > 0:
        came, torques, before_Nm = integers(table, 0, (1,)), integers(table, 1, (1,)), floats(table, 2, (1,))
        take_twin(came, torques, before_Nm, floats(table, 3, (1,)), floats(table, 4, (1,)))


@entry_point(COUNT, TABLE)
def _fill(twin_status: int, table: NDArray[np.int64]) -> int:
    if len(table) == 0:
        return CONTINUE
    reals, wholes = floats(table, 9, (1,)), integers(table, 10, (1,))
    of_drives, virtual_io = floats(table, 3, (1,)), floats(table, 4, (1,))
    places, of_virtual_io, rad_per_unit = integers(table, 5, (1,)), integers(table, 6, (1,)), floats(table, 7, (1,))
    for k in range(len(rad_per_unit)):
        place, shown = places[k * OF_DRIVE : (k + 1) * OF_DRIVE], of_drives[k * OF_DRIVE : (k + 1) * OF_DRIVE]
        reals[place[POSITION]] = shown[POSITION] / rad_per_unit[k]
        if place[VELOCITY] != _NOWHERE:
            reals[place[VELOCITY]] = shown[VELOCITY] / rad_per_unit[k]
        reals[place[TORQUE]] = shown[TORQUE]
        wholes[place[STATUSWORD]] = int(shown[STATUSWORD])
    for k in range(len(virtual_io)):
        reals[of_virtual_io[k]] = virtual_io[k]
    wholes[twin_status] = integers(table, 8, (1,))[TWIN_STATUS]
    return CONTINUE


@dataclass(frozen=True)
class ShownBy:
    """The signals that a drive fills, and what turns rad at its shaft into the machine's unit; "": none."""

    rad_per_unit: float
    position: str
    velocity: str
    torque: str
    statusword: str

    @property
    def signals(self) -> tuple[str, str, str, str]:
        """Signal names in the order of the measured columns."""
        return self.position, self.velocity, self.torque, self.statusword


@dataclass(frozen=True)
class SimulatedTorque:
    """A torque of an axis (from 1) that the twin reports by its residual, as a signal in addition."""

    axis: int
    signal: str
    residual: str


class Measured:
    """Vectors of the measurements. `of_drives` (4 D,); `virtual_io` (S,): the twin's signals, TPDO by TPDO, then
    the torques that follow from residuals; `came` (P,): 1 where a TPDO of the twin arrived in this cycle;
    `counted`: by CYCLES and so on.

    `sent_by`: the signals of each TPDO of the twin.
    """

    def __init__(
        self,
        kind: type[CycleSample],
        drives: Sequence[ShownBy],
        sent_by: Sequence[Sequence[str]],
        torques: Sequence[SimulatedTorque],
    ) -> None:
        names = [name for content in sent_by for name in content]
        ends = np.cumsum([len(content) for content in sent_by]).tolist()
        #: Slice of each TPDO's signals in `virtual_io`.
        self.parts = [slice(end - len(content), end) for end, content in zip(ends, sent_by, strict=True)]
        brought_by = {name: at for at, content in enumerate(sent_by) for name in content}
        rows = [
            (
                OF_DRIVE * (each.axis - 1) + TORQUE,
                len(names) + at,
                names.index(each.residual),
                brought_by[each.residual],
            )
            for at, each in enumerate(torques)
        ]
        names += [each.signal for each in torques]
        self.of_drives, self.virtual_io = np.zeros(OF_DRIVE * len(drives)), np.zeros(len(names))
        self.came, self.counted = np.zeros(len(sent_by), np.int64), np.zeros(_COUNTED, np.int64)
        self._counted = self.counted.data  # access to one value is faster than through the vector
        self.torques, self.before_Nm = np.array(rows, np.int64).reshape(-1), np.zeros(len(torques))
        places = [kind.place(name) if name else _NOWHERE for drive in drives for name in drive.signals]
        self._kept = (
            *(self.came, self.torques, self.before_Nm, self.of_drives, self.virtual_io),
            *(np.array(places, np.int64), kind.places(names), np.array([each.rad_per_unit for each in drives])),
            self.counted,
        )
        self._table = table_of(self._kept)
        self._filled: CycleSample | None = None
        self._filling: CompiledStage

    def count(self, cycles: int, bits: int) -> None:
        """Set the number of cycles run and the bits of the last one."""
        self._counted[CYCLES], self._counted[BITS] = cycles, bits

    def take_twin(self) -> None:
        """All of a cycle is here: what follows from it."""
        _take(self._table)

    def fill(self, sample: CycleSample) -> None:
        """Write into a sample: SI, positions and velocities in the machine's unit; and the twin's status."""
        self.filling(sample)()

    def filling(self, sample: CycleSample) -> CompiledStage:
        """Compiled stage that writes into a sample as `fill` does."""
        if sample is not self._filled:
            kept = *self._kept, sample.reals, sample.wholes
            place = type(sample).place("twin_status")
            self._filled, self._filling = (
                sample,
                CompiledStage(_fill, place, kept, fallback=never),
            )
        return self._filling


def warm_up() -> None:
    """Compile, or load from the cache, before a cycle has to wait for it."""
    nothing = np.zeros((0, TABLE_WIDTH), np.int64)
    _take(nothing)
    _fill(0, nothing)
