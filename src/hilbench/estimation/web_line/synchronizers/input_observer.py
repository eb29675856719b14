"""Unknown-input observer for a black-box model: one of its inputs is corrected until its outputs agree.

The model's rollers move as the measured ones. The input is the strain of the web that enters the span; the output is
the tension, by the measured torque of axis 2 and simulated. A disturbance observer (Ohishi, Nakao, Ohnishi, Miyachi
1987) finds the correction w that the model lacks. With a = v/L, the transport of the span, and s the strain that is
missing in it,

    s' = a·(w − δ − s)

where δ is the correction that acts. s is measured; the observer moves s and w by the same share of its innovation,
because a change of the plant is missing in the whole span at once. δ = w + k·s then lets the model agree with the rate
(1 + k)·a instead of that of the transport.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, sqrt

from hilbench.estimation.assumptions import TORQUE_FLOOR_NM
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line.config import InputConfig
from hilbench.estimation.web_line.synchronizers.base import Estimate, HeldSynchronizer, Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.regression import FILTER_S, RegressionRows

#: Largest gain on the missing strain: at low speed the model can't follow faster, only the noise would.
_MOST_GAIN = 30.0
#: Least stated E, whatever the torque.
_LEAST_PA = 1.0


class InputSynchronizer(HeldSynchronizer):
    """Estimator of an upstream-strain correction; E is stated as the value with the same effect."""

    def __init__(self, config: InputConfig, plant: Plant) -> None:
        super().__init__(config, plant)
        self._config = config
        self._rows = RegressionRows(plant)
        self._noise = NoiseLevel(config.torque_noise_Nm, TORQUE_FLOOR_NM)
        self._missing = self._lacking = self._acting = 0.0
        self._innovation = 0.0
        self._simulated: list[float] | None = None  # tension a cycle ago, and after each of the two low passes
        self._estimate = replace(self._estimate, upstream_strain=0.0)

    def update(self, sample: SyncSample) -> Estimate:
        """Compare the model, and set its next input."""
        self._noise.update(sample.torque_real_Nm)
        settled = self._rows.update(sample)
        simulated_N = self._simulated_N(sample)
        if not settled:
            return self._estimate
        plant, dt = self._plant, sample.cycle_s
        stiffness_N = plant.youngs_modulus_Pa * plant.section_m2
        rate_per_s = abs(sample.balance.velocity_m_s) / plant.span_length_m
        self._missing += rate_per_s * dt * (self._lacking - self._acting - self._missing)
        innovation = (float(self._rows.row[-1]) - simulated_N) / stiffness_N - self._missing
        share = dt / (self._config.observer_s + dt)
        self._missing += share * innovation
        self._lacking += share * innovation
        self._innovation += share * (innovation - self._innovation)
        agreement_per_s, limit = self._config.agreement_per_s, self._config.limit_share * sample.upstream_strain
        gain = min(max(agreement_per_s / rate_per_s - 1.0, 0.0), _MOST_GAIN) if rate_per_s > 0.0 else 0.0
        self._acting = min(max(self._lacking + gain * self._missing, -limit), limit)
        # The filter makes the noise smaller and correlated; over many samples it counts as before the filter.
        noise = self._noise.deviation * plant.force_per_torque_per_m / stiffness_N
        self._publish(sample, sqrt(0.5 * share * noise**2 + self._innovation**2))
        return self._estimate

    def hold(self, duration_s: float) -> Estimate:
        """Keep the correction; restart the filters."""
        self._rows.interrupt()
        self._simulated = None
        return super().hold(duration_s)

    def _simulated_N(self, sample: SyncSample) -> float:
        """Simulated tension, delayed and filtered like the measured one (`RegressionRows`)."""
        plant = self._plant
        now_N = sample.torque_sim_sensitivity_Nm_per_Pa * plant.force_per_torque_per_m * plant.youngs_modulus_Pa
        if self._simulated is None:
            self._simulated = [now_N] * 3
        before, first, second = self._simulated
        decay = exp(-sample.cycle_s / FILTER_S)
        first = before + (first - before) * decay
        second = first + (second - first) * decay
        self._simulated = [now_N, first, second]
        return second

    def _publish(self, sample: SyncSample, deviation: float) -> None:
        """Publish E with the same tension at the encoders' strain."""
        simulated = sample.torque_sim_sensitivity_Nm_per_Pa * self._plant.force_per_torque_per_m
        per_strain_Pa = self._plant.youngs_modulus_Pa * self._plant.section_m2 / sample.balance.web_per_Pa
        strain = simulated / self._plant.section_m2 + self._missing
        self._estimate = Estimate(
            max(per_strain_Pa * strain, _LEAST_PA),
            per_strain_Pa * deviation,
            (Nuisance("upstream_strain", self._lacking, deviation, separable=True),),
            upstream_strain=self._acting,
        )
