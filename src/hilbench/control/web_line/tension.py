"""Upstream tension control: the velocity of the axis before a span is set from its simulated tension; the axis after
it leads. Here the span is the first, between axes 1 and 2.

The loop is closed once the twin reports that it is synchronized, and open while the twin can't be trusted. An open loop
moves from the last ratio of speeds to the one that gives the set-point by mass conservation, with E as it was known:
(v1/v2)·(1 + ε_ref) = 1 + ε_prev, ε_ref = F_ref/ES. Kept as it was, the ratio of a moment in which the controller
was active would take the web to another strain altogether.

Linearized about F = ES·ε the span answers a velocity difference c = v2 − v1 with F' = (ES/L)·c − (v/L)·F. But roller
2 gives way to the web: below its velocity loop's bandwidth the integral part of the loop holds it like a spring of
k = ki·(i/r)², which is soft compared to the web's ES/L. So v2 falls by F'/k, and the span answers like one slower by
1 + κ, κ = ES/(L·k): (1 + κ)·F' = (ES/L)·c − (v/L)·F. The gain Kp = ω·(1 + κ)·L/ES gives the wanted bandwidth ω at every
line speed and stiffness. The integral time is that of the span, (1 + κ)·L/v, which cancels its pole, but 4/ω at most:
a slower pole would be cancelled for the set point only, and a disturbance would stay for its time (Skogestad 2003).
"""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np

from hilbench.compiled import Vector, compiled, interpreted, record_at, record_type
from hilbench.plant.web_line.parameters import ModelParameters

#: Longest integral time, times the bandwidth.
_LONGEST_INTEGRAL = 4.0
#: Time constants of an open loop's ratio on its way to the goal, and of the E that it uses.
_HOLD_S = 0.5
_KNOWN_S = 0.5

CONTROLLER = record_type(
    "bandwidth_rad_per_s",  # 0: none
    "limit_m_s",  # of the correction
    "length_m",
    "section_m2",
    "roller_N_per_m",  # stiffness that holds the roller after the span at low frequency; inf: it does not yield
    "upstream_strain",  # of the web before the span
    "downstream_strain",
    "integral_m_s",
    "ratio",  # of speeds
    "modulus_Pa",  # E as it was known; 0: before the loop was closed
    "is_open",
)


@compiled
def gains(c: Any, line_m_s: float, modulus_Pa: float) -> tuple[float, float]:
    """Kp in m/s per N and Ki in m/s per N·s of a `CONTROLLER` at a line speed and E."""
    stiffness_N = modulus_Pa * c.section_m2
    gives_way = stiffness_N / (c.length_m * c.roller_N_per_m)
    kp = c.bandwidth_rad_per_s * (1.0 + gives_way) * c.length_m / stiffness_N
    pole_length_m = (1.0 + gives_way) * c.length_m
    return kp, kp * max(abs(line_m_s) / pole_length_m, c.bandwidth_rad_per_s / _LONGEST_INTEGRAL)


gains_at = interpreted(gains)


@compiled
def _hold(c: Any, line_m_s: float, set_point_N: float, step_s: float, around_m_s: float) -> float:
    c.is_open = 1.0
    share = step_s / (_HOLD_S + step_s)
    if not isnan(around_m_s):
        c.ratio -= share * c.ratio
        return float(around_m_s - line_m_s * c.ratio)
    if c.modulus_Pa != 0.0:
        strain = set_point_N / (c.modulus_Pa * c.section_m2)
        wanted = 1.0 - (1.0 + c.upstream_strain) / (1.0 + strain)
        if line_m_s < 0.0:
            wanted = 1.0 - (1.0 + strain) / (1.0 + c.downstream_strain)
        c.ratio += share * (wanted - c.ratio)
    return float(line_m_s * (1.0 - c.ratio))


@compiled
def control(
    c: Any,
    closed: bool,
    line_m_s: float,
    set_point_N: float,
    tension_N: float,
    modulus_Pa: float,
    step_s: float,
    around_m_s: float,
) -> float:
    """Run a step of a `CONTROLLER`: velocity set point of the axis before the span in m/s, from tension and E where
    the loop is `closed`; bumpless transfer after an open one, and into it. `line_m_s`: velocity of the axis after the
    span, which it corrects, or `around_m_s` in its place: feed-forward velocity, NaN where there is none."""
    if not closed:
        return _hold(c, line_m_s, set_point_N, step_s, around_m_s)
    limit, error_N = c.limit_m_s, set_point_N - tension_N
    kp, ki = gains(c, line_m_s, modulus_Pa)
    known_Pa = c.modulus_Pa if c.modulus_Pa != 0.0 else modulus_Pa
    c.modulus_Pa = known_Pa + step_s / (_KNOWN_S + step_s) * (modulus_Pa - known_Pa)
    if c.is_open != 0.0:
        c.integral_m_s = c.ratio * line_m_s - kp * error_N
        c.is_open = 0.0
    integral = c.integral_m_s + ki * error_N * step_s
    correction = kp * error_N + integral
    if abs(correction) <= limit:
        c.integral_m_s = integral
    else:  # hold the integral while the limit is reached
        correction = limit if correction > 0.0 else -limit
    c.ratio = correction / line_m_s if line_m_s != 0.0 else 0.0
    return float((line_m_s if isnan(around_m_s) else around_m_s) - correction)


def tension_controller(
    bandwidth_rad_per_s: float, limit_m_s: float, model: ModelParameters, span: int, strains: tuple[float, float]
) -> Vector:
    """`CONTROLLER` of a span of a model, given the strains of the web before and after it. Raises ValueError without a
    web."""
    vector = np.zeros(CONTROLLER.itemsize // 8)
    c = record_at(vector, CONTROLLER)
    c.bandwidth_rad_per_s, c.limit_m_s = bandwidth_rad_per_s, limit_m_s
    c.length_m, c.section_m2 = model.span_length_m(span), model.section_m2(span)
    c.roller_N_per_m = model.drive_stiffness_N_per_m(span + 1)
    c.upstream_strain, c.downstream_strain = strains
    return vector
