"""The compiled bank of filters against the same equations with matrices, one hypothesis after the other."""

from __future__ import annotations

from dataclasses import dataclass, field
from math import exp, log, pi, sqrt

import numpy as np
import pytest

from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.synchronizers import filters
from hilbench.estimation.web_line.synchronizers.base import Plant, SyncSample
from hilbench.estimation.web_line.synchronizers.changepoint import ChangepointSynchronizer
from hilbench.estimation.web_line.synchronizers.filters import Filters

CYCLE_S, E_PA = 0.002, 8.7e9
PLANT = Plant(E_PA, 30.0, 25.0, 0.5 * 65e-6, 1.0)
#: Kinds of birth: cycles between two, cycles in which a newborn is kept.
JUMP, DRIFT, END = (2, 40), (50, 500), (50, 500)
YOUNG = sum(kept // every + 1 for every, kept in (JUMP, DRIFT, END))


@dataclass
class Hypothesis:
    z: np.ndarray
    p: np.ndarray
    weight: float = 0.0
    kept: int = JUMP[1]
    age: int = 0

    def step(self, u: np.void) -> None:
        """Predict by matrices, correct by the position; states x, v, E, its rate, error of the mass."""
        dt, mass = u["duration_s"], u["mass_kg"]
        g = np.array([0.0, 0.0, -u["web_N"] / mass, 0.0, -u["acceleration_m_s2"]])
        into = np.array([0.5 * dt * dt, dt, 0.0, 0.0, 0.0])
        f = np.eye(5) + np.outer(into, g)
        f[0, 1] += dt
        f[2, 3] += dt
        self.z = f @ self.z + into * u["force_N"] / mass
        self.p = f @ self.p @ f.T + np.outer(into, into) * u["force_variance"] / mass**2
        self.p[2, 2] += dt * u["parameter_variance_per_s"]
        wander = np.diag([1.0, 1.0, 1.0, 1.0, 1.0 - dt / 36000.0])
        self.z, self.p = wander @ self.z, wander @ self.p @ wander
        self.p[4, 4] += 2.0 * dt / 36000.0 * u["priors"][3] ** 2
        innovation, variance = u["position"] - self.z[0], self.p[0, 0] + u["position_variance"]
        gain = self.p[:, 0] / variance
        self.z = self.z + gain * innovation
        self.p = self.p - np.outer(gain, self.p[0])
        self.weight -= 0.5 * (innovation**2 / variance + log(2.0 * pi * variance))

    def child(self, prior: float, kept: int, jump_variance: float, rate_variance: float) -> Hypothesis:
        z, p = self.z.copy(), self.p.copy()
        z[3] = p[3, :] = p[:, 3] = 0.0
        p[2, 2] += jump_variance
        p[3, 3] = rate_variance
        return Hypothesis(z, p, self.weight + log(prior), kept)


@dataclass
class PlainBank:
    """Hypotheses in the order of their places; None: a place that is free."""

    config: ChangepointConfig
    places: list[Hypothesis | None] = field(default_factory=lambda: [None] * (YOUNG + 8))
    told: float = 1.0
    cycle: int = 0

    def start(self, x_m: float, mass_share: float) -> None:
        p = np.diag([1e-8, 1.0, (0.01 * self.config.initial_deviation_pct) ** 2, 0.0, mass_share**2])
        self.places[0] = Hypothesis(np.array([x_m, 0.0, 1.0, 0.0, 0.0]), p)

    def update(self, u: np.void) -> None:
        self.cycle += 1
        alive = [each for each in self.places if each is not None]
        for each in alive:
            each.step(u)
        best = max(each.weight for each in alive)
        for place, each in enumerate(self.places):
            if each is not None:
                each.age += 1
                each.weight -= best
                if each.weight < -12.0 and each.age >= each.kept:
                    self.places[place] = None
        alive = [each for each in self.places if each is not None]
        shares = np.array([exp(each.weight) for each in alive])
        shares /= shares.sum()
        moduli = np.array([each.z[2] for each in alive])
        found = float(shares @ moduli)
        noise = np.array([each.p[2, 2] - each.p[2, 4] ** 2 / each.p[4, 4] for each in alive])
        spread = sqrt(float(shares @ (noise + (moduli - found) ** 2)))
        self.told += min(1.0, (0.01 * self.config.cautious_pct / spread) ** 2) * (found - self.told)
        self._births()

    def _births(self) -> None:
        c = self.config
        if self.cycle % JUMP[0] == 0:
            size = 0.15 if self.cycle // JUMP[0] % 2 else 1.0
            self._birth(c.jumps_per_s * JUMP[0] * CYCLE_S, JUMP[1], (0.01 * c.jump_pct * size) ** 2, 0.0)
        onset = c.drift_onsets_per_s * DRIFT[0] * CYCLE_S
        if self.cycle % DRIFT[0] == 0:
            self._birth(onset, DRIFT[1], 0.0, (0.01 * c.drift_pct_per_s) ** 2)
        if self.cycle % END[0] == END[0] // 2 and self._best().p[3, 3] > 0.0:
            self._birth(onset, END[1], 0.0, 0.0)

    def _best(self) -> Hypothesis:
        return max((each for each in self.places if each is not None), key=lambda each: each.weight)

    def _birth(self, prior: float, kept: int, jump_variance: float, rate_variance: float) -> None:
        of_age = [(each.weight, place) for place, each in enumerate(self.places) if each and each.age >= each.kept]
        free = next((place for place, each in enumerate(self.places) if each is None), None)
        place = free if free is not None else min(of_age)[1] if of_age else None
        parent = self._best()
        if place is not None and self.places[place] is not parent:
            self.places[place] = parent.child(prior, kept, jump_variance, rate_variance)


def samples(cycles: int, stepped_at: int, seed: int) -> list[SyncSample]:
    """A roller at 3 m/s behind a web whose E steps by 15 %, torque and encoder noisy."""
    rng = np.random.default_rng(seed)
    web_per_Pa, x_m, v_m_s, before_m, found = 80.0 / E_PA, 0.0, 3.0, 0.0, []
    for k in range(cycles):
        modulus_Pa = E_PA * (1.15 if k >= stepped_at else 1.0)
        force_N = 80.0 + 9.0 * (k >= stepped_at) + 5.0 * np.sin(0.01 * k)
        v_m_s += (force_N - modulus_Pa * web_per_Pa) / 30.0 * CYCLE_S
        x_m += v_m_s * CYCLE_S
        seen_m = x_m + 1e-7 * rng.standard_normal()
        noise_Nm = 0.05 * rng.standard_normal()
        balance = BalanceSample(seen_m, force_N + 25.0 * noise_Nm, web_per_Pa, (seen_m - before_m) / CYCLE_S)
        found.append(SyncSample(CYCLE_S, 3.0 + noise_Nm, 3.0, 0.0, 3e-4, balance))
        before_m = seen_m
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_e_is_what_matrices_say_cycle_by_cycle_through_a_step(seed: int) -> None:
    config = ChangepointConfig()
    method, inputs, plain = (
        ChangepointSynchronizer(config, PLANT),
        Filters(config, PLANT, (0.0, 0.0, 1)),
        PlainBank(config),
    )
    inputs.inputs["parameter_variance_per_s"] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
    largest = 0.0
    rows = samples(400, 250, seed)
    plain.start(rows[0].balance.x2_m, config.also.inertia_share)
    for row in rows:
        estimate = method.update(row)
        if inputs.take(filters.FILL, row):
            plain.update(inputs.inputs)
        largest = max(largest, abs(estimate.youngs_modulus_Pa / E_PA - plain.told))
    assert largest < 1e-6
    assert plain.told > 1.1, "the step has been followed"


def test_methods_beside_each_other_know_nothing_of_each_other() -> None:
    rows = [samples(120, 60, seed) for seed in range(3)]

    def alone(of: list[SyncSample]) -> list[float]:
        method = ChangepointSynchronizer(ChangepointConfig(), PLANT)
        return [method.update(row).youngs_modulus_Pa for row in of]

    methods = [ChangepointSynchronizer(ChangepointConfig(), PLANT) for _ in rows]
    together = [
        [method.update(row).youngs_modulus_Pa for method, row in zip(methods, now, strict=True)]
        for now in zip(*rows, strict=True)
    ]
    assert [list(of_one) for of_one in zip(*together, strict=True)] == [alone(of) for of in rows]
