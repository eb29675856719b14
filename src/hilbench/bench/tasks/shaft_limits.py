"""Limits of a run of a servo axis: its torques, its speed, the deviation of its inertia."""

from __future__ import annotations

from collections.abc import Iterator

from hilbench.bench.tasks.limit_check import LimitCheck
from hilbench.bench.tasks.limits import (
    DiagnosisAnswer,
    Levels,
    Limited,
    LimitReading,
    apart,
    is_synchronized,
    lowest_threshold,
)
from hilbench.topology.config import BenchConfig
from hilbench.topology.safety import LimitsConfig
from hilbench.topology.sample import CycleSample


def limited(limits: LimitsConfig, motor: str) -> list[Limited]:
    """Signals of a servo axis with this load motor that have limits."""
    return [
        Limited("torque of axis 1", "tau1_Nm", "N·m", limits.torque_Nm),
        Limited("torque of the load motor", f"tau_{motor}_Nm", "N·m", limits.torque_Nm),
        Limited("speed of axis 1", "v1_rad_s", "rad/s", limits.speed_rad_s),
    ]


class ShaftLimitWatch:
    """Watches the samples of one run."""

    def __init__(self, config: BenchConfig, motor: str) -> None:
        self._inertia_kg_m2 = config.servo_axis.inertia_kg_m2
        self._levels = Levels()
        limits = config.safety.limits
        self._limited, self._ratio = limited(limits, motor), limits.estimate_ratio
        self._look = LimitCheck(
            [each.signal for each in self._limited],
            [lowest_threshold(each.limit) for each in self._limited],
            [("J_sim_kg_m2", self._inertia_kg_m2)],
            lowest_threshold(self._ratio),
        )

    def look(self, sample: CycleSample) -> LimitReading:
        """Compiled check of a sample (`limits.LimitMonitor`)."""
        return self._look.of(sample)

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        return [] if self.look(sample).is_below_limits else self.found(sample)

    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample not below its limits (`limits.LimitMonitor`)."""
        found = self._levels.check(sample.t_s, self._quantities(sample))
        self._look.warned(self._levels)
        return found

    def _quantities(self, sample: CycleSample) -> Iterator[DiagnosisAnswer]:
        for each in self._limited:
            yield each.name, abs(getattr(sample, each.signal)), f" {each.unit}", each.limit
        if is_synchronized(sample):
            ratio = apart(sample.J_sim_kg_m2, self._inertia_kg_m2)
            yield "estimate of the inertia over the model's", ratio, "", self._ratio
