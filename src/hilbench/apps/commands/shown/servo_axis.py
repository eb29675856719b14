"""A servo axis."""

from __future__ import annotations

from typing import Final

from hilbench.apps.commands.shown.machine import LiveRow, Shown
from hilbench.topology.signals import Shape

SHOWN: Final = Shown(
    live=(
        LiveRow("speed of the shaft", ("v1_rad_s",), "rad/s", ".1f"),
        LiveRow("inertia true", ("J_true_kg_m2", "J_sim_kg_m2"), "kg·cm²", ".2f", 1e-4, deviation="J_sd_kg_m2"),
        LiveRow("dry friction true / estimated", ("coulomb_true_Nm", "coulomb_sim_Nm"), "N·m", ".3f"),
    ),
    of_steps=(
        ("J in 1 %, s", "J_time_to_1pct_s"),
        ("noise, %", "J_noise_pct"),
        ("friction off, %", "coulomb_final_error_pct"),
        ("speed rms, rad/s", "speed_rms_error_rad_s"),
    ),
)


def shown(shape: Shape) -> Shown:
    """Of one shaft."""
    return SHOWN
