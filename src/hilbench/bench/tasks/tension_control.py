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

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import REAL, VECTOR, compiled, entry_point
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.config import BenchConfig
from hilbench.topology.web_line_config import TensionControlConfig

Vector = NDArray[np.float64]

#: Longest integral time, times the bandwidth.
_LONGEST_INTEGRAL = 4.0
#: Time constants of an open loop's ratio on its way to the goal, and of the E that it uses.
_HOLD_S = 0.5
_KNOWN_S = 0.5


def strains_around(config: BenchConfig, span: int) -> tuple[float, float]:
    """Strains of the web before and after a span, by the model: on each side that of the set-point of the nearest span
    with a controller, as an axis without one passes the strain on; that of the web around the line for none."""
    model, controls = config.web_line, config.tension_controls
    before = [control for number, control in controls.items() if number < span]
    behind = [control for number, control in controls.items() if number > span]
    return (
        before[-1].set_point_N / model.stiffness_N(before[-1].span) if before else model.upstream_strain,
        behind[0].set_point_N / model.stiffness_N(behind[0].span) if behind else model.downstream_strain,
    )


#: Of the vectors of `control`. Figures: bandwidth, limit of the correction, span and section, what holds the roller
#: behind it, strains upstream and downstream; state: integral in m/s, ratio of speeds, E as it was known (0: before the
#: loop was closed), whether it is open.
_BANDWIDTH, _LIMIT_M_S, _LENGTH_M, _AREA_M2, _ROLLER_N_PER_M, _UPSTREAM, _DOWNSTREAM, _FIGURES = range(8)
_INTEGRAL_M_S, _RATIO, _MODULUS_PA, _OPEN, _STATE = range(5)


@compiled
def _schedule(figures: Vector, modulus_Pa: float) -> tuple[float, float, float]:
    """Gain schedule (`TensionController.schedule`)."""
    stiffness_N = modulus_Pa * figures[_AREA_M2]
    gives_way = stiffness_N / (figures[_LENGTH_M] * figures[_ROLLER_N_PER_M])
    kp = figures[_BANDWIDTH] * (1.0 + gives_way) * figures[_LENGTH_M] / stiffness_N
    return kp, (1.0 + gives_way) * figures[_LENGTH_M], figures[_BANDWIDTH] / _LONGEST_INTEGRAL


@compiled
def _gains(figures: Vector, line_m_s: float, modulus_Pa: float) -> tuple[float, float]:
    """Gains Kp and Ki at a line speed (`TensionController.gains`)."""
    kp, length_m, least_per_s = _schedule(figures, modulus_Pa)
    return kp, kp * max(abs(line_m_s) / length_m, least_per_s)


@compiled
def _hold(figures: Vector, s: Vector, line_m_s: float, set_point_N: float, cycle_s: float, around_m_s: float) -> float:
    s[_OPEN] = 1.0
    if not np.isnan(around_m_s):
        s[_RATIO] -= cycle_s / (_HOLD_S + cycle_s) * s[_RATIO]
        return float(around_m_s - line_m_s * s[_RATIO])
    if s[_MODULUS_PA] != 0.0:
        strain = set_point_N / (s[_MODULUS_PA] * figures[_AREA_M2])
        wanted = 1.0 - (1.0 + figures[_UPSTREAM]) / (1.0 + strain)
        if line_m_s < 0.0:
            wanted = 1.0 - (1.0 + strain) / (1.0 + figures[_DOWNSTREAM])
        s[_RATIO] += cycle_s / (_HOLD_S + cycle_s) * (wanted - s[_RATIO])
    return float(line_m_s * (1.0 - s[_RATIO]))


@compiled
def control(
    figures: Vector,
    s: Vector,
    closed: bool,
    line_m_s: float,
    set_point_N: float,
    tension_N: float,
    modulus_Pa: float,
    cycle_s: float,
    around_m_s: float,
) -> float:
    """Run a cycle of the controller: velocity set point of the axis before the span in m/s, from tension and E where
    the loop is `closed`; bumpless transfer after an open one, and into it. `line_m_s`: velocity of the axis after the
    span, which it corrects, or `around_m_s` in its place: feed-forward velocity, NaN where there is none."""
    if not closed:
        return _hold(figures, s, line_m_s, set_point_N, cycle_s, around_m_s)
    limit, error_N = figures[_LIMIT_M_S], set_point_N - tension_N
    kp, ki = _gains(figures, line_m_s, modulus_Pa)
    known_Pa = s[_MODULUS_PA] if s[_MODULUS_PA] != 0.0 else modulus_Pa
    s[_MODULUS_PA] = known_Pa + cycle_s / (_KNOWN_S + cycle_s) * (modulus_Pa - known_Pa)
    if s[_OPEN] != 0.0:
        s[_INTEGRAL_M_S] = s[_RATIO] * line_m_s - kp * error_N
        s[_OPEN] = 0.0
    integral = s[_INTEGRAL_M_S] + ki * error_N * cycle_s
    correction = kp * error_N + integral
    if abs(correction) <= limit:
        s[_INTEGRAL_M_S] = integral
    else:  # hold the integral while the limit is reached
        correction = limit if correction > 0.0 else -limit
    s[_RATIO] = correction / line_m_s if line_m_s != 0.0 else 0.0
    return float((line_m_s if np.isnan(around_m_s) else around_m_s) - correction)


@entry_point(VECTOR, REAL)
def _schedule_once(figures: Vector, modulus_Pa: float) -> tuple[float, float, float]:
    return _schedule(figures, modulus_Pa)


@entry_point(VECTOR, REAL, REAL)
def _gains_once(figures: Vector, line_m_s: float, modulus_Pa: float) -> tuple[float, float]:
    return _gains(figures, line_m_s, modulus_Pa)


class TensionController:
    """PI controller with its gains scheduled on line speed and stiffness: the vectors of `control`.

    `roller_stiffness_N_per_m`: stiffness that holds the roller after the span against the web at low frequency; inf for
    one that does not yield.
    `strains`: of the web before and after the span.
    """

    def __init__(
        self,
        config: TensionControlConfig,
        span_length_m: float,
        section_m2: float,
        roller_stiffness_N_per_m: float,
        strains: tuple[float, float],
    ) -> None:
        #: Those of `control`.
        self.figures, self.state = np.zeros(_FIGURES), np.zeros(_STATE)
        self.figures[:] = (
            *(config.bandwidth_rad_per_s, config.correction_limit_m_s, span_length_m, section_m2),
            *(roller_stiffness_N_per_m, *strains),
        )
        self.reset()

    @classmethod
    def of_model(
        cls, config: TensionControlConfig, model: ModelParameters, strains: tuple[float, float]
    ) -> TensionController:
        """Controller for its span of a model, given the strains around it. Raises ValueError without a web."""
        section_m2, stiffness_N_per_m = model.section_m2(config.span), model.drive_stiffness_N_per_m(config.span + 1)
        return cls(config, model.span_length_m(config.span), section_m2, stiffness_N_per_m, strains)

    def schedule(self, modulus_Pa: float) -> tuple[float, float, float]:
        """Gain schedule at this E: Kp in m/s per N; a length in m, and a rate in 1/s. Ki is Kp times the line speed
        over that length, at least times that rate."""
        return _schedule_once(self.figures, float(modulus_Pa))

    def gains(self, line_speed_m_s: float, modulus_Pa: float) -> tuple[float, float]:
        """Kp in m/s per N and Ki in m/s per N·s at this speed and E."""
        return _gains_once(self.figures, float(line_speed_m_s), float(modulus_Pa))

    def assume_modulus(self, modulus_Pa: float) -> None:
        """Set the E that an open loop uses from now on."""
        self.state[_MODULUS_PA] = modulus_Pa

    def reset(self) -> None:
        """Forget the integral (drives off)."""
        self.state[:] = 0.0
