"""Diagnosis of axes whose drive feeds inertia and friction forward, and reports the loop's torque alone."""

from __future__ import annotations

import numpy as np
import pytest
from tests.diagnosis.axis_rig import axis_model
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, diagnose
from hilbench.results.recording import Recording

INERTIA, COULOMB_NM, VISCOUS, RIPPLE_NM = 1.9e-4, 0.03, 3e-4, 1.4e-3
STEP_S, EVERY = 1e-4, 10


def recording(fed_inertia: float, fed_coulomb_Nm: float, fed_viscous: float) -> Recording:
    """Ten seconds of a motor whose torque ripples five and ten times a turn, a velocity loop of 60 rad/s behind what is
    fed forward of its ramps; semi-implicit Euler steps."""
    t_s = np.arange(100_000) * STEP_S
    command = 60.0 * np.interp(t_s, [0.0, 2.0, 4.0, 6.0, 8.0, 10.0], [0.0, 1.0, 0.0, -1.0, 0.0, 0.3])
    kp, ki = 60.0 * INERTIA, 900.0 * INERTIA
    rates = np.gradient(command, STEP_S)
    x = v = integral = 0.0
    positions, torques = np.zeros(len(t_s)), np.zeros(len(t_s))
    for k, (speed, rate) in enumerate(zip(command, rates, strict=True)):
        error = speed - v
        integral += ki * error * STEP_S
        torques[k], positions[k] = kp * error + integral, x
        fed_Nm = fed_inertia * rate + fed_coulomb_Nm * np.sign(speed) + fed_viscous * speed
        ripple = RIPPLE_NM * (np.sin(5.0 * x) + 0.8 * np.sin(10.0 * x + 1.0))
        friction = COULOMB_NM * np.tanh(v / 0.05) + VISCOUS * v
        v += STEP_S * (torques[k] + fed_Nm + ripple - friction) / INERTIA
        x += STEP_S * v
    count = 2.0 * np.pi / 10_000
    noise = 5e-4 * np.random.default_rng(0).standard_normal(len(t_s))
    channels = {"t_s": t_s, "x1_m": count * np.round(positions / count), "tau1_Nm": torques + noise}
    return Recording({name: values[::EVERY] for name, values in channels.items()})


def ripples(found: Diagnosis) -> dict[float, NamedEffect]:
    named = (item for item in found.effects if item.effect == "torque_ripple")
    return {round(item.parameters["order"].value, 2): item for item in named}


@pytest.mark.parametrize("friction", [0.0, 1.06, *slow(1.0)])
def test_ripples_are_named_with_their_size_behind_a_feed_forward(friction: float) -> None:
    found = diagnose(recording(1.66e-4, friction * COULOMB_NM, VISCOUS), axis_model(1.66e-4), "axis")
    (lacking,) = (item for item in found.effects if item.effect == "inertia_mismatch")
    assert "feed_forward" in lacking.tied_with
    value = lacking.parameters["relative_change"]
    assert value.value == pytest.approx(INERTIA / 1.66e-4 - 2.0, abs=0.02)
    for order, size in ((5.0, RIPPLE_NM), (10.0, 0.8 * RIPPLE_NM)):
        assert ripples(found)[order].parameters["amplitude_Nm"].value == pytest.approx(size, rel=0.2)
    dry = [item.parameters["force_N"].value for item in found.effects if item.effect == "coulomb_friction"]
    assert dry == (pytest.approx([COULOMB_NM], rel=0.05) if friction == 0.0 else [])
    assert {item.effect for item in found.effects} <= {"inertia_mismatch", "torque_ripple", "coulomb_friction"}
    said = [repair.text for repair in found.repairs]
    assert said[-1].startswith("inertia is fed forward with commands up to ")
    assert ("more dry friction is fed forward than there is" in said[0]) == (friction > 1.0)


@pytest.mark.parametrize("model", [1.9e-3, *slow(1.66e-4)])
def test_without_a_feed_forward_nothing_is_taken_out(model: float) -> None:
    found = diagnose(recording(0.0, 0.0, 0.0), axis_model(model), "axis")
    (inertia,) = (item for item in found.effects if item.effect == "inertia_mismatch")
    assert inertia.parameters["relative_change"].value == pytest.approx(INERTIA / model - 1.0, abs=0.03)
    assert not found.repairs
