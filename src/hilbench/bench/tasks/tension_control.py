"""Upstream tension control: the velocity of the axis before a span is set from its simulated tension; the axis behind
it leads. Here the span is the first, between axes 1 and 2.

The loop is closed once the twin reports that it is synchronized, and open while the twin can't be trusted. An open loop
goes from the last ratio of speeds to the one that gives the set-point by mass conservation, with E as it was known:
(v1/v2)·(1 + ε_ref) = 1 + ε_prev, ε_ref = F_ref/ES. Kept as it was, the ratio of a moment in which the controller was
busy would take the web to another strain altogether.

Linearized about F = ES·ε the span answers a velocity difference c = v2 − v1 with F' = (ES/L)·c − (v/L)·F. But roller
2 gives way to the web: below its velocity loop's bandwidth the integral part of the loop holds it like a spring of
k = ki·(i/r)², which is soft beside the web's ES/L. So v2 falls by F'/k, and the span answers as one that is slower by
1 + κ, κ = ES/(L·k): (1 + κ)·F' = (ES/L)·c − (v/L)·F. The gain Kp = ω·(1 + κ)·L/ES gives the wanted bandwidth ω at every
line speed and stiffness. The integral time is that of the span, (1 + κ)·L/v, which cancels its pole, but 4/ω at most:
a slower pole would be cancelled for the set point only, and a disturbance would stay for its time (Skogestad 2003).
"""

from __future__ import annotations

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.topology.config import BenchConfig
from hilbench.topology.web_line_config import TensionControlConfig

#: Longest integral time, times the bandwidth.
_LONGEST_INTEGRAL = 4.0
#: Time constants of an open loop's way to its ratio, and of the E that it takes with it.
_HOLD_S = 0.5
_KNOWN_S = 0.5


def strain_before(config: BenchConfig, span: int) -> float:
    """Strain of the web that enters a span, by the model: that of the set-point of the nearest span before it with a
    controller, as an axis without one hands the strain on; that of the web upstream for none."""
    model = config.web_line
    before = [control for number, control in config.tension_controls.items() if number < span]
    return before[-1].set_point_N / model.stiffness_N(before[-1].span) if before else model.upstream_strain


class TensionController:
    """PI controller with its gains scheduled on line speed and stiffness; velocities at the web, m/s.

    `roller_stiffness_N_per_m`: what holds the roller behind the span against the web at low frequency; inf for one that
    does not yield.
    `upstream_strain`: of the web that enters the span.
    """

    def __init__(
        self,
        config: TensionControlConfig,
        span_length_m: float,
        section_m2: float,
        roller_stiffness_N_per_m: float,
        upstream_strain: float,
    ) -> None:
        self._config = config
        self._length_m = span_length_m
        self._area_m2 = section_m2
        self._roller_stiffness_N_per_m = roller_stiffness_N_per_m
        self._upstream_strain = upstream_strain
        self.reset()

    @classmethod
    def of_model(
        cls, config: TensionControlConfig, model: ModelParameters, upstream_strain: float
    ) -> TensionController:
        """For its span of a model, and the strain of the web that enters that. Raises ValueError without a web."""
        section_m2, stiffness_N_per_m = model.section_m2(config.span), model.drive_stiffness_N_per_m(config.span + 1)
        return cls(config, model.span_length_m(config.span), section_m2, stiffness_N_per_m, upstream_strain)

    def schedule(self, modulus_Pa: float) -> tuple[float, float, float]:
        """At this E: Kp in m/s per N; a length in m, and a rate in 1/s. Ki is Kp times the line speed over that length,
        at least times that rate."""
        stiffness_N = modulus_Pa * self._area_m2
        gives_way = stiffness_N / (self._length_m * self._roller_stiffness_N_per_m)
        kp = self._config.bandwidth_rad_per_s * (1.0 + gives_way) * self._length_m / stiffness_N
        return kp, (1.0 + gives_way) * self._length_m, self._config.bandwidth_rad_per_s / _LONGEST_INTEGRAL

    def gains(self, line_speed_m_s: float, modulus_Pa: float) -> tuple[float, float]:
        """Kp in m/s per N and Ki in m/s per N·s at this speed and E."""
        kp, length_m, least_per_s = self.schedule(modulus_Pa)
        return kp, kp * max(abs(line_speed_m_s) / length_m, least_per_s)

    def reset(self) -> None:
        """Forget the integral (drives off)."""
        self._integral_m_s = 0.0
        self._ratio = 0.0
        self._modulus_Pa: float | None = None  # None before the loop was closed
        self._closed = True

    def hold(
        self, line_speed_m_s: float, set_point_N: float, cycle_s: float, *, around_m_s: float | None = None
    ) -> float:
        """Velocity set point of the axis before the span while the loop is open, without a jump from what it was;
        `line_speed_m_s`: that of the axis behind it, `around_m_s`: what is known to be right already."""
        self._closed = False
        if around_m_s is not None:
            self._ratio -= cycle_s / (_HOLD_S + cycle_s) * self._ratio
            return around_m_s - line_speed_m_s * self._ratio
        if self._modulus_Pa is not None:
            strain = set_point_N / (self._modulus_Pa * self._area_m2)
            wanted = 1.0 - (1.0 + self._upstream_strain) / (1.0 + strain)
            self._ratio += cycle_s / (_HOLD_S + cycle_s) * (wanted - self._ratio)
        return line_speed_m_s * (1.0 - self._ratio)

    def velocity(
        self,
        line_speed_m_s: float,
        set_point_N: float,
        tension_N: float,
        modulus_Pa: float,
        cycle_s: float,
        *,
        around_m_s: float | None = None,
    ) -> float:
        """Velocity set point of the axis before the span in m/s from the (simulated) tension and Young's modulus;
        `line_speed_m_s`: that of the axis behind it, which it corrects, or `around_m_s` in its place.

        After `hold` it goes on from the held ratio, without a jump.
        """
        limit = self._config.correction_limit_m_s
        error_N = set_point_N - tension_N
        kp, ki = self.gains(line_speed_m_s, modulus_Pa)
        known_Pa = self._modulus_Pa or modulus_Pa
        self._modulus_Pa = known_Pa + cycle_s / (_KNOWN_S + cycle_s) * (modulus_Pa - known_Pa)
        if not self._closed:
            self._integral_m_s = self._ratio * line_speed_m_s - kp * error_N
            self._closed = True
        integral = self._integral_m_s + ki * error_N * cycle_s
        correction = kp * error_N + integral
        if abs(correction) <= limit:
            self._integral_m_s = integral
        else:  # hold the integral while the limit is reached
            correction = limit if correction > 0 else -limit
        self._ratio = correction / line_speed_m_s if line_speed_m_s else 0.0
        return (line_speed_m_s if around_m_s is None else around_m_s) - correction
