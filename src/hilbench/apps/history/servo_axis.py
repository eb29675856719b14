"""Estimates of a twin of a servo axis."""

from __future__ import annotations

from hilbench.apps.history.estimate import Estimate


def estimates() -> tuple[Estimate, ...]:
    """Estimates of its shaft."""
    return (
        Estimate("J_sim_kg_m2", "J_sd_kg_m2", "shaft.inertia_kg_m2", "kg·m²"),
        Estimate("coulomb_sim_Nm", "coulomb_sd_Nm", "shaft.coulomb_friction_Nm", "N·m"),
        Estimate(
            "viscous_sim_Nm_s_per_rad",
            "viscous_sd_Nm_s_per_rad",
            "shaft.viscous_friction_Nm_s_per_rad",
            "N·m·s/rad",
        ),
    )
