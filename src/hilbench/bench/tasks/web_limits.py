"""Limits of a run of a web line: tensions, torques, speeds, position differences of the axes, deviation of E."""

from __future__ import annotations

from hilbench.bench.tasks.limits import Limited, LimitWatch, load_motor_labels
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.safety import LimitsConfig
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
            signed=True,
        )
        for span in spans
    ]
    torques = [Limited(f"torque of axis {k}", f"tau{k}_Nm", "N·m", limits.torque_Nm) for k in axes]
    torques += [
        Limited(f"torque of {labels[name]}", f"tau_{name}_Nm", "N·m", limits.torque_Nm) for name in shape.load_motors
    ]
    speeds = [Limited(f"speed of axis {k}", f"v{k}_m_s", "m/s", limits.speed_m_s) for k in axes]
    return [*tensions, *torques, *speeds]


def limit_watch(limits: LimitsConfig, model: ModelParameters, cycle_s: float, shape: Shape) -> LimitWatch:
    """Watches the samples of one run of a web line. `model`: its E is compared with the estimate."""
    return LimitWatch(
        limited(limits, shape),
        "estimate of E over the model's",
        {f"E{shape.numbered(span)}_sim_Pa": model.youngs_modulus_Pa(span) for span in shape.estimated},
        limits.estimate_ratio,
        [
            f"position difference of {f'axes {axis} and {axis + 1}' if shape.axes > 2 else 'the axes'}"
            for axis in range(1, shape.axes)
        ],
        limits.position_difference_m,
        cycle_s,
    )
