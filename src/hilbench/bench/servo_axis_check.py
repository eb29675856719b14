"""Checks of a bench with a servo axis: its load motor can emulate the inertia of the machine."""

from __future__ import annotations

from hilbench.errors import UnusableInputError
from hilbench.plant.servo_axis.stability import imitable_inertia_kg_m2, sampled_shaft
from hilbench.strict_yaml import Document, Location
from hilbench.topology.config import BenchConfig


def check_servo_axis(config: BenchConfig, document: Document) -> None:
    """Raise UnusableInputError when the loop of emulated inertia, shaft and bus is unstable from the start."""
    location: Location = ("load", "shaft", "inertia_kg_m2") if config.load.shaft.inertia_kg_m2 else ("machine", "shaft")
    check_emulated_inertia(config, document, config.emulated_shaft().inertia_kg_m2, location)


def imitable_inertias_kg_m2(config: BenchConfig) -> tuple[float, float]:
    """The least and the largest inertia that the load motor of a servo axis emulates stably."""
    return imitable_inertia_kg_m2(sampled_shaft(config.servo_rig_parameters(), config.cycle_time_s))


def check_emulated_inertia(config: BenchConfig, document: Document, inertia_kg_m2: float, where: Location) -> None:
    """Raise UnusableInputError at `where` when the loop of emulated inertia, shaft and bus is unstable with it."""
    least, largest = imitable_inertias_kg_m2(config)
    if not least < inertia_kg_m2 < largest:
        raise UnusableInputError(
            document.place(where),
            f"the load motor can't emulate an inertia of {inertia_kg_m2:.4g} kg·m² over a cycle of "
            f"{config.cycle_time_s * 1e3:g} ms: the loop of shaft and bus is stable from {least:.4g} to "
            f"{largest:.4g} kg·m², expected a shorter cycle or a heavier shaft on the stand",
        )
