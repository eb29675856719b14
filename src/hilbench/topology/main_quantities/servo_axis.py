"""A servo axis: the speed of its shaft, and the emulated inertia and dry friction."""

from __future__ import annotations

from typing import Final

from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.signals import Shape

SPEED: Final = MainQuantity("speed_rad_s", "speed of the shaft", "speed", "rad/s", "v1_cmd_rad_s", "v")
INERTIA: Final = MainQuantity(
    "load.shaft.inertia_kg_m2",
    "inertia of the emulated shaft",
    "J",
    "kg·m²",
    "J_true_kg_m2",
    "m",
    "J_sim_kg_m2",
    "J_sd_kg_m2",
    shown_unit="kg·cm²",
    si_per_shown=1e-4,
    emulated=True,
)
FRICTION: Final = MainQuantity(
    "load.shaft.coulomb_friction_Nm",
    "dry friction of the emulated shaft",
    "friction",
    "N·m",
    "coulomb_true_Nm",
    "f",
    "coulomb_sim_Nm",
    emulated=True,
)


def main_quantities(shape: Shape) -> tuple[MainQuantity, ...]:
    """Quantities of any servo axis."""
    return INERTIA, FRICTION, SPEED
