"""The drives of a bench as its cyclic path sees them where there is no twin: what fits on a wire that is too short for
both."""

from __future__ import annotations

from dataclasses import replace

from hilbench.canopen.pdo import PdoMap
from hilbench.cia402.configuration import DriveSettings
from hilbench.exchange.addressing import IoMaps, drive_settings
from hilbench.exchange.nodes import Nodes
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Part, Role
from hilbench.topology.process_data.table import ProcessData


class _Nothing(IoMaps):
    """Of a virtual I/O that says nothing, and is told nothing."""

    @property
    def tpdos(self) -> list[PdoMap]:
        """None."""
        return []


def drives_alone(config: BenchConfig, *, velocity: bool) -> Nodes:
    """Each drive with the TPDOs that a bench maps, or, without `velocity`, with the first."""
    status = IoMaps.of(config).status
    nothing = _Nothing(ProcessData((), (), (), ()), (), status, ())
    return Nodes(config, io=nothing, settings_of=drive_settings if velocity else _without_velocity)


def _without_velocity(config: BenchConfig, part: Part) -> DriveSettings:
    settings = drive_settings(config, part)
    return settings if part.role is Role.VIRTUAL_AXIS else replace(settings, has_velocity=False)
