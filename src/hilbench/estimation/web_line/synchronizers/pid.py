"""Published method: tracking simulation with a PID correction of Young's modulus.

Source: the validation experiment of "synchronized online simulation" of a web-transport section: the error is the real
minus the simulated motor torque of axis 2, Young's modulus is moved until it vanishes, and the integral of the error is
limited so that a slow answer to a fast change does not overshoot.
"""

from __future__ import annotations

import math

from hilbench.estimation.web_line.config import PidConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, Plant, Synchronizer, SyncSample


class PidSynchronizer(Synchronizer):
    """PID correction dE/dt = Kp·e + Ki·∫e dt + Kd·de/dt with limited integral; E is kept within its plausible range."""

    def __init__(self, config: PidConfig, plant: Plant) -> None:
        self._config = config
        self._modulus_Pa = plant.youngs_modulus_Pa
        self._error_Nm = 0.0
        self._integral_Nm_s = 0.0
        self._scatter_Nm2 = 0.0
        self._last = Estimate(plant.youngs_modulus_Pa, math.inf)

    def update(self, sample: SyncSample) -> Estimate:
        """Move E by the error of the torque."""
        c, dt = self._config, sample.cycle_s
        raw_Nm = sample.torque_real_Nm - sample.torque_sim_Nm
        error_Nm = self._error_Nm + dt / (c.error_filter_s + dt) * (raw_Nm - self._error_Nm)
        slope_Nm_per_s = (error_Nm - self._error_Nm) / dt
        self._scatter_Nm2 += dt / 1.0 * ((raw_Nm - error_Nm) ** 2 - self._scatter_Nm2)
        self._error_Nm = error_Nm
        limit = c.integral_limit_Nm_s
        self._integral_Nm_s = min(limit, max(-limit, self._integral_Nm_s + error_Nm * dt))
        rate_Pa_per_s = (
            c.kp_Pa_per_Nm_s * error_Nm + c.ki_Pa_per_Nm_s2 * self._integral_Nm_s + c.kd_Pa_per_Nm * slope_Nm_per_s
        )
        self._modulus_Pa = min(c.upper_limit_Pa, max(c.lower_limit_Pa, self._modulus_Pa + rate_Pa_per_s * dt))
        self._last = Estimate(self._modulus_Pa, self._deviation_Pa(sample))
        return self._last

    def hold(self, duration_s: float) -> Estimate:
        """Hold the loop; a lasting error is not known to grow."""
        return self._last

    def _deviation_Pa(self, sample: SyncSample) -> float:
        """Standard deviation of E by torque noise, and by the present error that is not yet corrected.

        The loop is a first-order filter of the torque error with rate k = Kp·∂τ/∂E, so white noise of standard
        deviation σ per sample leaves Kp·σ·√(Δt/2k) in E; a lasting error e is e/(∂τ/∂E).
        """
        c = self._config
        torque_per_Pa = abs(sample.torque_sim_sensitivity_Nm_per_Pa)
        if torque_per_Pa == 0.0 or c.kp_Pa_per_Nm_s == 0.0:
            return math.inf
        rate_per_s = c.kp_Pa_per_Nm_s * torque_per_Pa
        noise_Pa = c.kp_Pa_per_Nm_s * math.sqrt(self._scatter_Nm2 * sample.cycle_s / (2.0 * rate_per_s))
        return math.hypot(noise_Pa, self._error_Nm / torque_per_Pa)
