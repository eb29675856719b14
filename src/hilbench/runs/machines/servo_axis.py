"""A servo axis: the estimates of inertia and friction, how the shaft follows its speed, what the twin leaves over."""

from __future__ import annotations

from typing import Final

from hilbench.arrays import Array
from hilbench.runs.machines.machine import Estimate, MachineMetrics, nothing_to_judge, speed_metrics
from hilbench.runs.segment import Metric, Segment
from hilbench.topology.servo_axis import FRICTION, INERTIA, SPEED
from hilbench.topology.signals import Shape

_NOTHING: Final = nothing_to_judge("shaft")


def _speed_error(segment: Segment) -> Array:
    return segment.error("v1_rad_s", SPEED.signal)


_FOLLOWING: Final = {
    "speed_rms_error_rad_s": Metric(
        "rad/s",
        "rms of the shaft's velocity minus its command since the step",
        _NOTHING,
        lambda s: s.rms(_speed_error(s)),
    ),
    "speed_peak_error_rad_s": Metric(
        "rad/s", "largest velocity error of the shaft since the step", _NOTHING, lambda s: s.peak(_speed_error(s))
    ),
    "torque_residual_rms_Nm": Metric(
        "N·m",
        "rms of measured minus simulated torque since the step",
        _NOTHING,
        lambda s: s.rms(s.get("tau1_residual_Nm")),
    ),
}

METRICS: Final = MachineMetrics(
    SPEED,
    {
        **Estimate(INERTIA, "shaft").metrics(),
        **Estimate(FRICTION, "shaft").metrics(),
        **speed_metrics(SPEED, "the shaft", "v1_rad_s"),
        **_FOLLOWING,
    },
    moves_always=True,
)


def metrics_of(shape: Shape) -> MachineMetrics:
    """Metrics of a shaft."""
    return METRICS
