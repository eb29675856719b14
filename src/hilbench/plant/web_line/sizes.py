"""Usual sizes of a web line or lone axis, of which the sizes of effects are shares."""

from __future__ import annotations

from math import inf
from typing import Final

from hilbench.plant.effect import MachineSizes
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.stations import Reel

#: Share of a roller's radius by which positions of one instant may differ: encoders, and slip.
_ALIKE_SHARE: Final = 5e-4
#: By how much of an acceleration rollers may differ in a cycle, m/s²: five times what those of one line did that is
#: brought to 2 m/s in 1 s by set points that go in steps of 16 ms.
_ALIKE_M_S2: Final = 2.0
#: Share of the usual strain of a span by which they may: its tension changes as much, which a loop hardly shows, while
#: the rollers of a soft web, at the start, move by more than the others.
_ALIKE_STRAINS: Final = 0.1


def least_travel_m(model: ModelParameters, cycle_s: float) -> float:
    """Least travel at the web for counting cycles by it: a share of the smallest roller, by how much drives follow a
    step of their set points differently in a cycle of `cycle_s`, and a share of the web's elongation.

    inf where a dancer, an accumulator or a reel lets the rollers turn at speeds of their own: travel has no information
    then.
    """
    if model.carriages or any(isinstance(roller.station, Reel) for roller in model.line_rollers):
        return inf
    smallest_m = min(model.radius_m(axis) for axis in range(1, model.axis_count + 1))
    shortest_m = min((model.span_length_m(span) for span in range(1, model.span_count + 1)), default=0.0)
    alike_m = _ALIKE_STRAINS * abs(model.upstream_strain) * shortest_m
    return max(_ALIKE_SHARE * smallest_m, _ALIKE_M_S2 * cycle_s**2, alike_m)


def machine_sizes(
    model: ModelParameters,
    axis: int | None,
    *,
    top_speed_m_s: float = 1.0,
    torque_Nm: float | None = None,
    sample_time_s: float | None = None,
) -> MachineSizes:
    """Usual sizes at an axis (from 1; None: the first) of the machine of a model.

    top_speed_m_s: highest speed at the web, which is not in a model; only sizes that depend on it need it. torque_Nm:
    usual torque at the motor; without a web the force follows from it, and its default is the drive's limit (1 N·m
    where the model has none). sample_time_s: that of a recording, for a model without drives; default 1 ms.
    """
    axis = 1 if axis is None else axis
    radius_m, per_m = model.radius_m(axis), model.motor_rad_per_m(axis)
    tension_N = max(model.boundary.upstream_tension_N, model.boundary.downstream_tension_N)
    drives = model.drives
    if model.web is None or tension_N <= 0.0:
        limit_Nm = per_item(drives.torque_limit_Nm, axis) if drives is not None else 1.0
        force_N = per_m * (limit_Nm if torque_Nm is None else torque_Nm)
    else:
        force_N = tension_N
    strain = force_N / model.stiffness_N(1) if model.web is not None else 1.0
    time_s = drives.sample_time_s if drives is not None else sample_time_s
    return MachineSizes(
        force_N=force_N,
        speed_m_s=top_speed_m_s,
        radius_m=radius_m,
        gear_ratio=per_m * radius_m,
        strain=strain,
        sample_time_s=0.001 if time_s is None else time_s,
    )
