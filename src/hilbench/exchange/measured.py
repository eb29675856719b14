"""Measurements of drives and twin from cycle to cycle, written into a sample by compiled code on vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import (
    COUNT,
    TABLE,
    Reals,
    Wholes,
    arrays_in,
    compiled,
    entry_point,
    load,
    merged,
    record_type,
    records,
    table_of,
)
from hilbench.cycle_program import CONTINUE, CompiledStage, never
from hilbench.topology.process_data.table import SimulatedTorque
from hilbench.topology.sample import CycleSample, PerSample

#: What is measured of a drive (SI), and where that is in a sample (-1: nowhere).
_OF_DRIVE = "position", "velocity", "torque", "statusword"
_DRIVE, _PLACES = record_type(*_OF_DRIVE), record_type(*_OF_DRIVE, of=np.int64)
OF_DRIVE = len(_OF_DRIVE)
#: A simulated torque by its residual: place of the measured one, its own place and that of its residual in the twin's
#: signals, and the TPDO that carries it.
RESIDUAL = record_type("measured", "simulated", "residual", "brought_by", of=np.int64)
_NOWHERE = -1
#: What is counted: cycles, and bits on the bus in the last one; the SYNC that the twin has answered last, by its count,
#: and its status (bits of `TwinStatus`).
COUNTED = record_type("cycles", "bits", "twin_sync", "twin_status", of=np.int64)


class FromTwin(NamedTuple):
    """Measurements, and what the twin's TPDOs bring to them."""

    came: Wholes = np.zeros(0, np.int64)
    torques: Annotated[Any, records(RESIDUAL)] = np.zeros(0, RESIDUAL)
    before_Nm: Reals = np.zeros(0)
    of_drives: Reals = np.zeros(0)
    virtual_io: Reals = np.zeros(0)


class _Sample(NamedTuple):
    """Measurements with their places in a sample."""

    of_drives: Annotated[Any, records(_DRIVE)]
    virtual_io: Reals
    counted: Annotated[Any, COUNTED]
    places: Annotated[Any, records(_PLACES)]
    of_virtual_io: Wholes
    rad_per_unit: Reals
    values: Reals
    words: Wholes


@merged
def take_twin(a: FromTwin) -> None:
    """Update simulated torques from their residuals after a cycle in which these TPDOs of the twin `came` (P,).

    The residual is that of the cycle before: the twin compared after this cycle's TPDO was due.
    """
    for k in range(len(a.before_Nm)):
        row = a.torques[k]
        if a.came[row.brought_by] != 0:
            a.virtual_io[row.simulated] = a.before_Nm[k] - a.virtual_io[row.residual]
        a.before_Nm[k] = a.of_drives[row.measured]


@compiled
def twin_age_cycles(syncs: int, twin_sync: int) -> int:
    """Age in cycles of the twin's last answer, from the 16-bit SYNC counters of bench and twin."""
    # Started while SYNCs were running it may have counted one or two more than the bench.
    age = ((syncs - twin_sync + 0x8000) & 0xFFFF) - 0x8000
    return age if age > 0 else 0


@entry_point(TABLE)
def _take(table: NDArray[np.int64]) -> None:
    take_twin(arrays_in(table, FromTwin))


@entry_point(COUNT, TABLE)
def _fill(twin_status: int, table: NDArray[np.int64]) -> int:
    a = arrays_in(table, _Sample)
    values, words = a.values, a.words
    for k in range(len(a.places)):
        place, shown, rad_per_unit = a.places[k], a.of_drives[k], a.rad_per_unit[k]
        values[place.position] = shown.position / rad_per_unit
        if place.velocity != _NOWHERE:
            values[place.velocity] = shown.velocity / rad_per_unit
        values[place.torque] = shown.torque
        words[place.statusword] = int(shown.statusword)
    for k in range(len(a.virtual_io)):
        values[a.of_virtual_io[k]] = a.virtual_io[k]
    words[twin_status] = a.counted.twin_status
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


class Measured:
    """Vectors of the measurements. `of_drives` (4 D,); `virtual_io` (S,): the twin's signals, TPDO by TPDO, then
    the `torques` that follow from residuals; `came` (P,): 1 where a TPDO of the twin arrived in this cycle;
    `counted`: a record `COUNTED`.

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
        measured = [OF_DRIVE * (each.axis - 1) + _OF_DRIVE.index("torque") for each in torques]
        rows = [
            (place, len(names) + at, names.index(each.residual), brought_by[each.residual])
            for at, (place, each) in enumerate(zip(measured, torques, strict=True))
        ]
        names += [each.name for each in torques]
        self.of_drives, self.virtual_io = np.zeros(OF_DRIVE * len(drives)), np.zeros(len(names))
        self.came, self.counted = np.zeros(len(sent_by), np.int64), np.zeros(1, COUNTED)
        places = [tuple(kind.place(name) if name else _NOWHERE for name in drive.signals) for drive in drives]
        self.from_twin = FromTwin(
            self.came, np.array(rows, RESIDUAL), np.zeros(len(torques)), self.of_drives, self.virtual_io
        )
        self._table = table_of(self.from_twin)
        self._places = np.array(places, _PLACES), kind.places(names), np.array([each.rad_per_unit for each in drives])
        #: Compiled stage that writes into a sample as `fill` does.
        self.filling = PerSample(self._filling)

    def count(self, cycles: int, bits: int) -> None:
        """Set the number of cycles run and the bits of the last one."""
        counted = self.counted[0]
        counted["cycles"], counted["bits"] = cycles, bits

    def take_twin(self) -> None:
        """All of a cycle is here: what follows from it."""
        _take(self._table)

    def fill(self, sample: CycleSample) -> None:
        """Write into a sample: SI, positions and velocities in the machine's unit; and the twin's status."""
        self.filling(sample)()

    def _filling(self, sample: CycleSample) -> CompiledStage:
        of_drives = self.of_drives.view(_DRIVE)
        arrays = _Sample(
            of_drives, self.virtual_io, self.counted, *self._places, values=sample.reals, words=sample.wholes
        )
        return CompiledStage(_fill, type(sample).place("twin_status"), arrays, fallback=never)


def warm_up() -> None:
    """Compile, or load from the cache, before a cycle has to wait for it."""
    load(_take, _fill)
