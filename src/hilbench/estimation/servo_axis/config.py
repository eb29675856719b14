"""Configuration of inertia and friction estimation of a servo axis: a block of the `twin:` block's `estimate` list."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, PositiveFloat

from hilbench.block import Block


class BesideInertia(Block):
    """Nuisance parameters in addition to the inertia, beyond the model's: prior standard deviation; 0: not
    estimated."""

    coulomb_friction_Nm: float = Field(default=0.2, ge=0, description="dry friction")
    viscous_friction_Nm_s_per_rad: float = Field(default=0.005, ge=0, description="friction in proportion to speed")
    torque_offset_Nm: float = Field(default=0.02, ge=0, description="of the torque's measurement")
    unbalance_Nm: float = Field(default=0.0, ge=0, description="of either component, sine and cosine of the angle")


class InertiaConfig(Block):
    """Change-point estimator: bank of Kalman filters, one per hypothesis of the inertia's last jump or drift onset."""

    method: Literal["changepoint"] = "changepoint"
    torque_noise_Nm: PositiveFloat = Field(default=0.05, description="believed until it is measured (0.1 s)")
    initial_deviation_pct: PositiveFloat = Field(default=20.0, description="of the inertia at the start")
    jumps_per_s: PositiveFloat = Field(default=1e-3, description="how often the inertia is believed to jump")
    jump_pct: PositiveFloat = Field(default=20.0, description="standard deviation of a jump")
    drift_onsets_per_s: PositiveFloat = Field(default=1e-3, description="how often a drift is believed to begin")
    drift_pct_per_s: PositiveFloat = Field(default=2.0, description="standard deviation of a drift's rate")
    wander_pct_per_sqrt_s: float = Field(default=0.02, ge=0, description="random walk of the inertia at all times")
    hold_growth_pct_per_s: PositiveFloat = Field(
        default=2.0, description="growth of the deviation, as a random walk, while there is no usable sample"
    )
    friction_memory_s: PositiveFloat = Field(
        default=600.0,
        description="time in which friction may wander through what is believed of it, and take up a law that the"
        " model lacks",
    )
    offset_memory_s: PositiveFloat = Field(
        default=28800.0, description="the same of the torque's offset, which changes with a shift"
    )
    unmodelled_pct: float = Field(
        default=0.3, ge=0, description="what the inertia may lastingly be off by: part of its stated deviation"
    )
    also: BesideInertia = BesideInertia()
