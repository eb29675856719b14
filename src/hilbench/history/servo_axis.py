"""What a twin of a servo axis estimates."""

from __future__ import annotations

from hilbench.history.estimate import Estimate


def estimates() -> tuple[Estimate, ...]:
    """Of its shaft."""
    return (
        Estimate("J_sim_kg_m2", "J_sd_kg_m2", "shaft.inertia_kg_m2", "kg·m²"),
        Estimate("coulomb_sim_Nm", "", "shaft.coulomb_friction_Nm", "N·m"),
    )
