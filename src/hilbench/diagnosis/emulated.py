"""Emulation of the machine of a bench's recording, from the bench config that made it."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from hilbench.diagnosis.machines import AnyEmulation
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import declared_units
from hilbench.machine_kinds import machine_part
from hilbench.results.run_folder import RunFolder
from hilbench.runs.config import load
from hilbench.topology.config import BenchConfig
from hilbench.topology.parts import Role


def emulation_of(config: BenchConfig) -> AnyEmulation | None:
    """Emulation used by the bench of this config; None without a load motor. Without EDS files the drives' rounding
    is unknown."""
    resolution = None
    with suppress(UnusableInputError):  # a run folder that was brought here from another machine
        resolution = tuple(_resolution(config, axis) for axis in range(1, len(config.drives) + 1))
    found: AnyEmulation | None = machine_part(config.machine.kind, "diagnosis").emulation(config, resolution)
    return found


def _resolution(config: BenchConfig, axis: int) -> float:
    """Resolution of an axis's velocity command in its drive, in the machine's unit of position per s."""
    part = config.parts_of(Role.AXIS)[axis - 1]
    units = declared_units(part)
    return units.velocity_rad_s / config.machine.motor_rad_per_unit(axis)


def emulation_beside(recording: Path) -> AnyEmulation | None:
    """Emulation by the config in the run folder that a recording lies in; None if it lies in no run folder.

    Raises UnusableInputError for a config that can't be read.
    """
    folder = RunFolder(recording.parent)
    return emulation_of(load(folder.config)[0]) if folder.config.is_file() else None
