"""An arm that its motor and a hand swing: gravity and inertia nearly make up for one another, and no one recorded the
hand. The equations of motion are integrated by scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, diagnose
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.results.recording import Recording

INERTIA_KG_M2, GRAVITY_NM, FRICTION_NM, MOTOR_NM = 0.165, 3.3, 0.1, 0.3
SECONDS, PERIOD_S, COUNT_RAD = 20.0, 5e-3, 3e-3


def swung(seed: int, hand_Nm: float) -> Recording:
    """By a motor and a hand, of so many N·m rms, each led through random values."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0.0, SECONDS + 1.0, 0.4), np.arange(0.0, SECONDS + 1.0, 0.7)
    motor, hand = (size * rng.standard_normal(len(at)) for size, at in zip((MOTOR_NM, hand_Nm), knots, strict=True))

    def rates(t_s: float, state: list[float]) -> list[float]:
        angle, speed = state
        driving = np.interp(t_s, knots[0], motor) + np.interp(t_s, knots[1], hand)
        against = GRAVITY_NM * np.sin(angle) + FRICTION_NM * np.tanh(100.0 * speed)
        return [speed, float(driving - against) / INERTIA_KG_M2]

    t_s = np.arange(0.0, SECONDS, PERIOD_S)
    angle = solve_ivp(rates, (0.0, SECONDS), [1.0, 0.0], t_eval=t_s, max_step=2e-3).y[0]
    torque_Nm = np.interp(t_s, knots[0], motor) + 0.01 * rng.standard_normal(len(t_s))
    return Recording({"t_s": t_s, "x1_rad": COUNT_RAD * np.round(angle / COUNT_RAD), "tau1_Nm": torque_Nm})


def gravity(found: Diagnosis) -> list[NamedEffect]:
    return [item for item in found.effects if item.effect == "unbalance"]


def examined(recording: Recording, inertia_kg_m2: float) -> Diagnosis:
    return diagnose(recording, ServoAxisParameters(shaft=ShaftParameters(inertia_kg_m2=inertia_kg_m2)), "blind")


@pytest.mark.parametrize(("seed", "hand_Nm"), [(2, 0.6), *slow((0, 0.6), (3, 0.6), (1, 0.3), (2, 0.3))])
def test_beside_a_hand_gravity_is_not_what_makes_up_for_a_wrong_inertia(seed: int, hand_Nm: float) -> None:
    found = examined(swung(seed, hand_Nm), 0.05)
    assert found.verdict == "unknown"
    for item in gravity(found):
        low, high = item.parameters["amplitude_Nm"].ci95
        assert low <= GRAVITY_NM <= high
