"""Checks of a bench with a servo axis: its load motor can emulate the inertia of the machine."""

from __future__ import annotations

from hilbench.errors import UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.plant.servo_axis.stability import imitable_inertia_kg_m2, sampled_shaft
from hilbench.strict_yaml import Document, Location
from hilbench.topology.config import BenchConfig
from hilbench.topology.quantities import SHAFT_COULOMB_FRICTION, SHAFT_INERTIA, SPEED
from hilbench.topology.safety import LARGEST_RATIO


def ranges(config: BenchConfig) -> dict[str, tuple[float, float]]:
    """Speed (rad/s), inertia (kg·m²) and dry friction (N·m) of the emulated shaft."""
    limits, model = config.safety.limits, config.servo_axis
    speed_rad_s, ratio = limits.speed_rad_s.highest, min(limits.estimate_ratio.highest, LARGEST_RATIO)
    return {
        SPEED: (-speed_rad_s, speed_rad_s),
        SHAFT_INERTIA: (model.inertia_kg_m2 / ratio, model.inertia_kg_m2 * ratio),
        SHAFT_COULOMB_FRICTION: (0.0, limits.torque_Nm.highest),
    }


def check_servo_axis(config: BenchConfig, document: Document, nodes: Nodes) -> list[str]:
    """No notes. Raises UnusableInputError when the loop of emulated inertia, shaft and bus is unstable."""
    location: Location = ("load", "shaft", "inertia_kg_m2") if config.load.shaft.inertia_kg_m2 else ("machine", "shaft")
    check_emulated_inertia(config, document, config.emulated_shaft().inertia_kg_m2, location)
    return []


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
