"""A joint beside another one: what is hidden in it is found with the other's motion, and not without."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.diagnosis.two_link_arm import Arm

from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.results.recording import Recording

ARM = Arm()


def found_in(recording: Recording) -> Diagnosis:
    model = ServoAxisParameters.model_validate({"kind": "servo_axis", "shaft": {"inertia_kg_m2": 1e-2}})
    return diagnose(recording, model, "the arm")


@cache
def of_joint(joint: int, *, with_other: bool = True) -> Diagnosis:
    return found_in(ARM.recording(joint, with_other=with_other))


def sizes(found: Diagnosis) -> dict[str, float]:
    """Of each effect, its first parameter."""
    return {effect.effect: next(iter(effect.parameters.values())).value for effect in found.effects}


@pytest.mark.parametrize("joint", [1, 2])
def test_gravity_and_friction_of_a_joint_are_named_with_the_motion_of_the_other(joint: int) -> None:
    found = of_joint(joint)
    assert found.verdict == "named"
    assert sizes(found) == {
        "unbalance": pytest.approx(ARM.gravity_Nm[joint - 1], rel=0.05),
        "coulomb_friction": pytest.approx(ARM.coulomb_Nm[joint - 1], rel=0.1),
    }


def test_encoders_may_have_any_zero() -> None:
    arm = replace(ARM, zeros_rad=(0.6, -1.1))
    found = found_in(arm.recording(1, with_other=True))
    assert sizes(found) == pytest.approx(sizes(of_joint(1)), rel=0.02)
    of_arm = found.nuisance[0].parameters
    turned = np.hypot(of_arm["arm_kg_m2"].value, of_arm["arm_turned_kg_m2"].value)
    assert turned == pytest.approx(of_joint(1).nuisance[0].parameters["arm_kg_m2"].value, rel=0.02)


@pytest.mark.parametrize("joint", [1, 2])
def test_without_it_they_are_not(joint: int) -> None:
    found = of_joint(joint, with_other=False)
    assert found.nuisance == []
    assert sizes(found).get("unbalance") != pytest.approx(ARM.gravity_Nm[joint - 1], rel=0.05)
    assert found.verdict == "unknown"


def test_what_the_other_axis_makes_is_no_effect_but_said_with_its_size() -> None:
    (of_shoulder,), (of_elbow,) = of_joint(1).nuisance, of_joint(2).nuisance
    m2, l1, r2 = ARM.masses_kg[1], ARM.length_m, ARM.centres_m[1]
    for coupling in (of_shoulder, of_elbow):
        assert (coupling.effect, coupling.axis) == ("coupling", 1)
        assert coupling.parameters["inertia_kg_m2"].value == pytest.approx(m2 * r2**2 + ARM.inertias_kg_m2[1], rel=0.1)
        assert coupling.parameters["arm_kg_m2"].value == pytest.approx(m2 * l1 * r2, rel=0.1)
    assert of_shoulder.parameters["gravity_sin_Nm"].value == pytest.approx(ARM.gravity_Nm[1], rel=0.1)
    assert "carries" in of_joint(1).predicted_on
    assert "carried" in of_joint(2).predicted_on


def test_what_can_not_be_told_beside_another_axis_asks_for_it_to_be_held() -> None:
    asked = {blind.effect for blind in of_joint(1).unobservable if "held" in blind.experiment}
    assert asked == {"torque_scale", "torque_delay", "feed_forward", "inertia_mismatch", "resonance"}


def test_an_axis_that_is_not_coupled_changes_nothing() -> None:
    alone = ARM.recording(2, with_other=False)
    elsewhere = np.cumsum(np.sin(3.0 * alone.time_s) * 2e-3)
    found = found_in(Recording({**alone.channels, "x2_rad": elsewhere}))
    without = of_joint(2, with_other=False)
    assert found.predicted_on == without.predicted_on
    assert found.effects == without.effects
    assert found.gaps == without.gaps
