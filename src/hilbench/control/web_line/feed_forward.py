"""Feed-forward of a tension loop from the twin's estimates: a span's set-point, the strain
that comes into it and the line's speed need not become an error first, and neighbours are not disturbed.

Mass conservation in span j, solved for the speed of the roller before it at the wanted strain ε and its rate:

    v_j = (v_{j+1} - L·ε'/(1 + ε)) · (1 + ε_{j-1}) / (1 + ε),   ε = F/(E·S)
    v_j = v_{j+1} · (1 + ε) / (1 + ε_{j+1}) - L·ε'/(1 + ε)      in reverse

with E and the strain of the span that the web comes from as the twin has them; ε is on its way to that of the
set-point. That roller is also the one after span j - 1: the rollers before it take their speeds from its command by
the ratios of their own spans, so a correction in one span is passed on to all rollers on the side away from the
master speed, and only there.

A roller held by a velocity loop u → kp·(u - v) + ki·∫(u - v) gives way to a force until the integral has taken it up.
For a force f that is known (m·a at a ramp, the difference of the wanted tensions, with what a change of E that the twin
has found makes of them) the command that keeps v as planned leads it by (f - f')/kp, f' being f behind a lag of kp/ki.
The last roller gets the line's speed only: the others are commanded to follow its compliance.
"""

from __future__ import annotations

from math import isnan, nan
from typing import Any

import numpy as np

from hilbench.compiled import Vector, compiled, record_at, record_type
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.parameters import ModelParameters

#: Share of a motor's greatest torque that feed-forward may use.
_TORQUE_SHARE = 0.5
#: A roller, at the web.
ROLLER = record_type(
    "mass_kg",
    "kp_N_s_per_m",  # 0: no feed-forward
    "share",  # of the missing force that the drive takes up in a step
    "limit_N",  # of the feed-forward
    "is_pulled",  # whether the web loads it
    "held_N",  # force that its drive has taken up (NaN: what is there)
)


@compiled
def lead_m_s(r: Any, acceleration_m_s2: float, force_N: float) -> float:
    """Lead of a `ROLLER`'s command over its planned speed, so that its drive has the torque in time: from the planned
    acceleration and the force that pulls it back."""
    if r.kp_N_s_per_m <= 0.0:
        return 0.0
    wanted_N = r.mass_kg * acceleration_m_s2 + force_N
    held_N = wanted_N if isnan(r.held_N) else r.held_N
    ahead_N = min(max(wanted_N - held_N, -r.limit_N), r.limit_N)
    r.held_N = held_N + r.share * (wanted_N - held_N)
    return float(ahead_N / r.kp_N_s_per_m)


@compiled
def plan_leads(rollers: Any, trajectories: Any, acceleration_m_s2: float, leads_m_s: Vector) -> None:
    """Write the leads of all rollers (N,) at an acceleration of the line, with the trajectories of the spans between
    them (N - 1,); spans without one count as having a constant tension."""
    last = len(rollers) - 1
    for k in range(last, -1, -1):
        pull_N = 0.0
        if k < last:
            acceleration_m_s2 -= trajectories[k].length_m * trajectories[k].bend_per_s2
        if k > 0:
            pull_N += rollers[k].is_pulled * trajectories[k - 1].tension_N
        if k < last:
            pull_N -= rollers[k].is_pulled * trajectories[k].tension_N
        leads_m_s[k] = lead_m_s(rollers[k], acceleration_m_s2, pull_N)
    leading_m_s = leads_m_s[last]
    for k in range(last + 1):
        leads_m_s[k] -= leading_m_s


def roller(mass_kg: float, kp_N_s_per_m: float, ki_N_per_m: float, limit_N: float, step_s: float) -> Vector:
    """`ROLLER` whose drive has what is there; `kp_N_s_per_m`, `ki_N_per_m`: of its velocity loop, at the web."""
    vector = np.zeros(ROLLER.itemsize // 8)
    r = record_at(vector, ROLLER)
    # With this share the leads of a step sum up to the final integral of the drive.
    r.share = min(step_s * ki_N_per_m / kp_N_s_per_m, 1.0) if kp_N_s_per_m > 0.0 else 0.0
    r.mass_kg, r.kp_N_s_per_m, r.limit_N, r.is_pulled, r.held_N = mass_kg, kp_N_s_per_m, limit_N, 1.0, nan
    return vector


def rollers_of(model: ModelParameters, step_s: float) -> list[Vector]:
    """`ROLLER` of each axis of a model with drives."""
    assert model.drives is not None, "a bench's model has drives"
    found = []
    for axis in range(1, model.axis_count + 1):
        ratio = model.motor_rad_per_m(axis)
        kp = per_item(model.drives.velocity_kp_Nm_s_per_rad, axis) * ratio**2
        ki = per_item(model.drives.velocity_ki_Nm_per_rad, axis) * ratio**2
        limit_N = _TORQUE_SHARE * per_item(model.drives.torque_limit_Nm, axis) * ratio
        found.append(roller(model.mass_kg(axis), kp, ki, limit_N, step_s))
        record_at(found[-1], ROLLER).is_pulled = float(model.carries_web_load(axis))
    return found
