"""Limits of a run of a servo axis: its torques, its speed, how far off the inertia is."""

from __future__ import annotations

from collections.abc import Iterator
from operator import attrgetter

from hilbench.bench.tasks.limits import Levels, Limited, Watched, apart, is_synchronized, least_told
from hilbench.topology.config import BenchConfig
from hilbench.topology.safety import LimitsConfig
from hilbench.topology.sample import CycleSample


def limited(limits: LimitsConfig, motor: str) -> list[Limited]:
    """What has limits and is a signal of a servo axis with this load motor."""
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
        self._values = attrgetter(*(each.signal for each in self._limited))
        self._told_from = [least_told(each.limit) for each in self._limited]
        self._ratio_told_from = least_told(self._ratio)

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        values: tuple[float, ...] = self._values(sample)
        if self._levels.quiet and self._is_quiet(sample, values):
            return []
        return self._levels.check(sample.t_s, self._quantities(sample, values))

    def _is_quiet(self, sample: CycleSample, values: tuple[float, ...]) -> bool:
        """Whether everything is so small that there is nothing to say, as in nearly every cycle."""
        for value, least in zip(values, self._told_from, strict=True):
            if not -least < value < least:
                return False
        return not is_synchronized(sample) or apart(sample.J_sim_kg_m2, self._inertia_kg_m2) < self._ratio_told_from

    def _quantities(self, sample: CycleSample, values: tuple[float, ...]) -> Iterator[Watched]:
        for each, value in zip(self._limited, values, strict=True):
            yield each.name, abs(value), f" {each.unit}", each.limit
        if is_synchronized(sample):
            ratio = apart(sample.J_sim_kg_m2, self._inertia_kg_m2)
            yield "estimate of the inertia over the model's", ratio, "", self._ratio
