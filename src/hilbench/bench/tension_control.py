"""Upstream tension control: the velocity of axis 1 is set from the simulated tension; axis 2 holds the line speed.

Linearized about F = ES·ε the span answers a velocity difference c = v2 − v1 with
F' = (ES/L)·c − (v/L)·F. A PI controller that cancels the span's pole v/L leaves a first-order loop of the
wanted bandwidth ω at every line speed: Kp = ω·L/ES, Ki = ω·v/ES. At standstill the span integrates by itself,
so Ki vanishes with v.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat


class TensionControlConfig(BaseModel):
    """The `tension_control:` block of a bench config."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    set_point_N: PositiveFloat = 80.0
    bandwidth_rad_per_s: PositiveFloat = Field(default=3.0, description="of the closed tension loop")
    correction_limit_m_s: PositiveFloat = Field(default=0.02, description="largest |v1 - v2| the controller asks for")


class TensionController:
    """PI controller with its gains scheduled on line speed and stiffness; velocities at the web, m/s."""

    def __init__(self, config: TensionControlConfig, span_length_m: float, section_m2: float) -> None:
        self._config = config
        self._length_m = span_length_m
        self._area_m2 = section_m2
        self._integral_m_s = 0.0

    def reset(self) -> None:
        """Forget the integral (loop opened, drives off)."""
        self._integral_m_s = 0.0

    def velocity(
        self, line_speed_m_s: float, set_point_N: float, tension_N: float, modulus_Pa: float, cycle_s: float
    ) -> float:
        """Velocity set point of axis 1 in m/s from the (simulated) tension and Young's modulus."""
        limit = self._config.correction_limit_m_s
        stiffness_N = modulus_Pa * self._area_m2
        error_N = set_point_N - tension_N
        kp = self._config.bandwidth_rad_per_s * self._length_m / stiffness_N
        ki = self._config.bandwidth_rad_per_s * abs(line_speed_m_s) / stiffness_N
        integral = self._integral_m_s + ki * error_N * cycle_s
        correction = kp * error_N + integral
        if abs(correction) <= limit:
            self._integral_m_s = integral
        else:  # hold the integral while the limit is reached
            correction = limit if correction > 0 else -limit
        return line_speed_m_s - correction
