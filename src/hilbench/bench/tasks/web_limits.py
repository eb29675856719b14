"""Limits of a run of a web line: tensions, torques, speeds, position differences of the axes, deviation of E."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hilbench.bench.tasks.limit_check import LimitCheck
from hilbench.bench.tasks.limits import (
    DiagnosisAnswer,
    Levels,
    Limited,
    LimitReading,
    apart,
    is_synchronized,
    load_motor_labels,
    lowest_threshold,
)
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.safety import LimitsConfig
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import Shape


def limited(limits: LimitsConfig, shape: Shape) -> list[Limited]:
    """Signals of a line that have limits: tensions of the spans, torques of the axes and of the load motors,
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
    """Watches the samples of one run of a web line. `model`: its E is compared with the estimate."""

    def __init__(self, limits: LimitsConfig, model: ModelParameters, cycle_s: float, shape: Shape) -> None:
        self._limits = limits
        self._levels = Levels()
        axes, spans = range(1, shape.axes + 1), range(1, shape.spans + 1)
        watched = limited(limits, shape)
        self._limited = [(each.name, each.signal, f" {each.unit}", each.limit) for each in watched]
        self._tensions = {f"F{shape.numbered(span)}_true_N" for span in spans}
        self._moduli = [(f"E{shape.numbered(span)}_sim_Pa", model.youngs_modulus_Pa(span)) for span in shape.estimated]
        self._differences = [
            f"position difference of {f'axes {axis} and {axis + 1}' if shape.axes > 2 else 'the axes'}"
            for axis in axes[:-1]
        ]
        self._look = LimitCheck(
            [each.signal for each in watched],
            [lowest_threshold(each.limit) for each in watched],
            self._moduli,
            lowest_threshold(limits.estimate_ratio),
            [f"x{axis}_m" for axis in axes],
            [f"v{axis}_cmd_m_s" for axis in axes],
            lowest_threshold(limits.position_difference_m),
            cycle_s,
        )

    def look(self, sample: CycleSample) -> LimitReading:
        """Compiled check of a sample (`limits.LimitMonitor`)."""
        return self._look.of(sample)

    def update(self, sample: CycleSample) -> list[tuple[str, str]]:
        """The warnings that begin in this cycle, each after its quantity. Raises LimitTripError."""
        return [] if self.look(sample).is_below_limits else self.found(sample)

    def found(self, sample: CycleSample) -> list[tuple[str, str]]:
        """Events of a sample not below its limits (`limits.LimitMonitor`)."""
        found = self._levels.check(sample.t_s, self._quantities(sample, self._look.apart))
        self._look.warned(self._levels)
        return found

    def _quantities(self, sample: CycleSample, apart_m: Sequence[float]) -> Iterator[DiagnosisAnswer]:
        limits = self._limits
        for name, signal, unit, limit in self._limited:
            value = getattr(sample, signal)
            yield name, value if signal in self._tensions else abs(value), unit, limit
        for name, difference_m in zip(self._differences, apart_m, strict=True):
            yield name, difference_m, " m", limits.position_difference_m
        if is_synchronized(sample):
            for signal, modulus_Pa in self._moduli:
                ratio = apart(getattr(sample, signal), modulus_Pa)
                yield "estimate of E over the model's", ratio, "", limits.estimate_ratio
