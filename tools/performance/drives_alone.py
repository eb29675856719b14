"""The drives of a bench as its cyclic path sees them where there is no twin: what fits on a wire that is too short for
both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.drive import Drive
from hilbench.exchange.addressing import IoMaps
from hilbench.exchange.measured import Measured
from hilbench.exchange.nodes import Nodes
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import sample_type


class _Nothing(IoMaps):
    """Of a virtual I/O that says nothing, and is told nothing."""

    @property
    def tpdos(self) -> list[tuple[int, PdoMap]]:
        """None."""
        return []


class DrivesAlone(Nodes):
    """Each with the TPDOs that a bench maps, or, without `velocity`, with the first."""

    def __init__(self, config: BenchConfig, *, velocity: bool) -> None:
        super().__init__(config)
        if not velocity:
            self.axes, self.load_motors = map(_without_velocity, (self.axes, self.load_motors))
            self._drives = *self.axes, *self.load_motors
            self._set_points = [
                (drive, name, unit) for drive, (_, name, unit) in zip(self._drives, self._set_points, strict=True)
            ]
        self.io = _Nothing(self.io.data, (), self.io.status, ())
        self._boundary_names, self._told, self._said, self._twin_tpdos = (), [], [], []
        theirs = {pdo.cob_id for drive in self._drives for _, pdo, _ in drive.pdos.tpdos}
        self._tpdos = {cob_id: tpdo for cob_id, tpdo in self._tpdos.items() if cob_id in theirs}
        self._tpdos_of = [[self._tpdos[pdo.cob_id] for _, pdo, _ in drive.pdos.tpdos] for drive in self._drives]
        self.measured = Measured(sample_type(config.signals), self._shown_by, [], [])
        self._counted = self.measured.counted.data


def _without_velocity(drives: Sequence[Drive]) -> tuple[Drive, ...]:
    return tuple(Drive(replace(drive.settings, has_velocity=False), drive.od) for drive in drives)
