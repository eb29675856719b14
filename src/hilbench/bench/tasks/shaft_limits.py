"""Limits of a run of a servo axis: its torques, its speed, the deviation of its inertia."""

from __future__ import annotations

from hilbench.bench.tasks.limits import Limited, LimitWatch
from hilbench.topology.config import BenchConfig
from hilbench.topology.safety import LimitsConfig


def limited(limits: LimitsConfig, motor: str) -> list[Limited]:
    """Signals of a servo axis with this load motor that have limits."""
    return [
        Limited("torque of axis 1", "tau1_Nm", "N·m", limits.torque_Nm),
        Limited("torque of the load motor", f"tau_{motor}_Nm", "N·m", limits.torque_Nm),
        Limited("speed of axis 1", "v1_rad_s", "rad/s", limits.speed_rad_s),
    ]


def limit_watch(config: BenchConfig, motor: str) -> LimitWatch:
    """Watches the samples of one run."""
    limits, models = config.safety.limits, {"J_sim_kg_m2": config.servo_axis.inertia_kg_m2}
    return LimitWatch(limited(limits, motor), "estimate of the inertia over the model's", models, limits.estimate_ratio)
