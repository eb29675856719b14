"""Limits of a run of a web line: tensions, torques, speeds, how far apart the axes are, how far off E is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import inf
from operator import attrgetter

from hilbench.bench.tasks.limits import Levels, Watched, apart, is_synchronized, least_told, load_motor_labels
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.safety import Limit, LimitsConfig
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape


@dataclass(frozen=True, slots=True)
class Limited:
    """A quantity whose size a signal shows: what messages call it, its unit, and its levels."""

    name: str
    signal: str
    unit: str
    limit: Limit


def limited(limits: LimitsConfig, shape: Shape) -> list[Limited]:
    """What has limits and is a signal of a line: tensions of the spans, torques of the axes and of the load motors,
    speeds of the axes."""
    axes, spans = range(1, shape.axes + 1), range(1, shape.spans + 1)
    labels = load_motor_labels(shape.load_motors)
    tensions = [
        Limited(
            f"tension of span {span}" if shape.spans > 1 else "tension of the web",
            f"F{shape.numbered(span)}_true_N",
            "N",
            limits.tension_N,
        )
        for span in spans
    ]
    torques = [Limited(f"torque of axis {k}", f"tau{k}_Nm", "N·m", limits.torque_Nm) for k in axes]
    torques += [
        Limited(f"torque of {labels[name]}", f"tau_{name}_Nm", "N·m", limits.torque_Nm) for name in shape.load_motors
    ]
    speeds = [Limited(f"speed of axis {k}", f"v{k}_m_s", "m/s", limits.speed_m_s) for k in axes]
    return [*tensions, *torques, *speeds]


class LimitWatch:
    """Watches the samples of one run of a web line. `model`: with whose E the estimate is compared."""

    def __init__(self, limits: LimitsConfig, model: ModelParameters, cycle_s: float, shape: Shape) -> None:
        self._limits = limits
        self._levels = Levels()
        spans = range(1, shape.spans + 1)
        watched = limited(limits, shape)
        self._limited = [(each.name, each.signal, f" {each.unit}", each.limit) for each in watched]
        self._sizes = attrgetter("t_s", *(each.signal for each in watched))  # with the time there are always several
        self._told_from = [inf, *(least_told(each.limit) for each in watched)]
        self._apart_told_from_m = least_told(limits.position_difference_m)
        self._ratio_told_from = least_told(limits.estimate_ratio)
        self._tensions = {f"F{shape.numbered(span)}_true_N" for span in spans}
        self._differences = [_PositionDifference(axis, shape, cycle_s) for axis in range(1, shape.axes)]
        self._moduli = [(f"E{shape.numbered(span)}_sim_Pa", model.youngs_modulus_Pa(span)) for span in shape.estimated]

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        apart_m = [difference.update(sample) for difference in self._differences]
        if self._levels.quiet and self._is_quiet(sample, apart_m):
            return []
        return self._levels.check(sample.t_s, self._quantities(sample, apart_m))

    def _is_quiet(self, sample: CycleSample, apart_m: Sequence[float]) -> bool:
        """Whether everything is so small that there is nothing to say, as in nearly every cycle."""
        for size, told_from in zip(self._sizes(sample), self._told_from, strict=True):
            if not -told_from < size < told_from:
                return False
        if not max(apart_m) < self._apart_told_from_m:
            return False
        if not is_synchronized(sample):
            return True
        return all(apart(getattr(sample, name), modulus) < self._ratio_told_from for name, modulus in self._moduli)

    def _quantities(self, sample: CycleSample, apart_m: Sequence[float]) -> Iterator[Watched]:
        limits = self._limits
        for name, signal, unit, limit in self._limited:
            value = getattr(sample, signal)
            yield name, value if signal in self._tensions else abs(value), unit, limit
        for difference, difference_m in zip(self._differences, apart_m, strict=True):
            yield difference.name, difference_m, " m", limits.position_difference_m
        if is_synchronized(sample):
            for signal, modulus_Pa in self._moduli:
                ratio = apart(getattr(sample, signal), modulus_Pa)
                yield "estimate of E over the model's", ratio, "", limits.estimate_ratio


class _PositionDifference:
    """Of an axis and the one behind it, beyond what their set points add up to since the drives were enabled."""

    def __init__(self, axis: int, shape: Shape, cycle_s: float) -> None:
        self.name = f"position difference of {f'axes {axis} and {axis + 1}' if shape.axes > 2 else 'the axes'}"
        self._values = attrgetter(f"x{axis}_m", f"x{axis + 1}_m", f"v{axis}_cmd_m_s", f"v{axis + 1}_cmd_m_s")
        self._cycle_s = cycle_s
        self._at_start_m: float | None = None
        self._commanded_m = 0.0

    def update(self, sample: CycleSample) -> float:
        """Its size with this sample, m."""
        before_m, behind_m, before_cmd_m_s, behind_cmd_m_s = self._values(sample)
        difference_m = before_m - behind_m
        if self._at_start_m is None:
            self._at_start_m = difference_m
        self._commanded_m += (before_cmd_m_s - behind_cmd_m_s) * self._cycle_s
        return float(abs(difference_m - self._at_start_m - self._commanded_m))
