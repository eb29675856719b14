"""The search for terms, on an axis of which every response is a formula: what is right is known."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from tests.diagnosis.analytic import NOISE, Axis, Bent, Ringing
from tests.plant.models import effect

from hilbench.diagnosis.free_rules import FreeRules, price
from hilbench.diagnosis.search import search
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.terms import Place

SMOOTH = ("coulomb_friction", "viscous_friction", "friction_asymmetry", "torque_offset", "inertia_mismatch")


def searched(axis: Axis, *vocabulary: str) -> Selection:
    return search(FreeRules(axis.space, axis.proposer(*(vocabulary or SMOOTH))))


def named(selection: Selection) -> list[str]:
    return sorted(term.effect.id for term in selection.fit.terms)


@pytest.mark.parametrize("seed", range(5))
def test_nothing_is_chosen_where_there_is_only_noise(seed: int) -> None:
    assert named(searched(Axis(seed=seed))) == []


@pytest.mark.parametrize(
    "item",
    [
        effect("coulomb_friction", 1, force_N=0.05),
        effect("viscous_friction", 1, coefficient_N_s_per_m=0.05),
        effect("friction_asymmetry", 1, viscous_difference_N_s_per_m=-0.05),
        effect("torque_offset", 1, offset_Nm=0.02),
        effect("inertia_mismatch", 1, relative_change=-0.01),
    ],
    ids=lambda item: str(item["effect"]),
)
def test_what_is_hidden_is_chosen_alone_with_its_value(item: dict[str, object]) -> None:
    found = searched(Axis(item, seed=7))
    assert named(found) == [item["effect"]]
    (name, value), *_ = item["parameters"].items()  # type: ignore[attr-defined]
    deviation = float(np.sqrt(found.fit.covariance[0, 0]))
    assert found.fit.terms[0].values[name] == pytest.approx(value, abs=4.0 * deviation)
    evidence = found.evidence[found.fit.terms[0].key]
    assert evidence["criterion_gain"] > 0.0
    assert evidence["held_out_gain"] > 0.0
    assert not found.exhausted


def test_what_alone_explains_all_is_chosen_before_four_that_promise_more() -> None:
    """What a small change of it does says little of what it does: four others look more like it."""
    bent = Bent(1.6)
    steps = FreeRules(bent.space, bent.proposer())
    nothing = steps.fit_of([])
    found = steps.best_addition(nothing, steps.candidates(nothing))
    assert found is not None
    (term,) = found.terms
    assert term.values["offset_Nm"] == pytest.approx(bent.strength_Nm, rel=0.01)


def test_the_order_in_which_effects_are_offered_changes_nothing() -> None:
    hidden = effect("coulomb_friction", 1, force_N=0.5), effect("inertia_mismatch", 1, relative_change=0.1)
    results = []
    for order in list(permutations(SMOOTH))[::30]:
        found = searched(Axis(*hidden, seed=1), *order)
        values = {t.effect.id: t.values[t.effect.strength[0]] for t in found.fit.terms}
        results.append(values)
    assert all(values.keys() == {"coulomb_friction", "inertia_mismatch"} for values in results)
    for values in results[1:]:
        assert values == pytest.approx(results[0], rel=1e-3)


def test_of_explanations_that_are_the_same_the_first_of_the_vocabulary_is_named_and_the_other_tied() -> None:
    """Forward only, b·v and d·|v| are one."""
    forward = Axis(effect("friction_asymmetry", 1, viscous_difference_N_s_per_m=0.4), forward=True)
    assert forward.v_m_s.min() > 0.0
    found = searched(forward, "friction_asymmetry", "viscous_friction", "torque_offset")
    assert named(found) == ["viscous_friction"]
    assert found.tied[found.fit.terms[0].key] == [Place("friction_asymmetry", 1)]
    both_ways = searched(Axis(effect("friction_asymmetry", 1, viscous_difference_N_s_per_m=0.4)))
    assert named(both_ways) == ["friction_asymmetry"]
    assert both_ways.tied[both_ways.fit.terms[0].key] == []


def test_three_effects_at_once_are_chosen_and_nothing_beside_them() -> None:
    hidden = (
        effect("coulomb_friction", 1, force_N=1.0),
        effect("viscous_friction", 1, coefficient_N_s_per_m=1.0),
        effect("torque_offset", 1, offset_Nm=0.5),
    )
    found = searched(Axis(*hidden, seed=2))
    assert named(found) == ["coulomb_friction", "torque_offset", "viscous_friction"]


def test_a_residual_that_nothing_offered_explains_stays_and_is_not_spread_over_what_is_offered() -> None:
    axis = Axis(seed=3)
    axis.space.predictor.measured = axis.space.predictor.measured + 0.5 * np.sign(np.sin(2.0 * np.pi * 7.3 * axis.t_s))
    found = searched(axis)
    assert np.std(found.fit.residual) > 5.0 * NOISE
    assert found.tied == {}
    assert found.evidence == {}


def test_every_parameter_and_every_variant_that_was_searched_has_its_price() -> None:
    axis = Axis()
    friction, stribeck = axis.term("coulomb_friction"), axis.proposer("stribeck_friction").direct()
    assert len(stribeck) == 3
    one = price([friction], 1000.0)
    assert one > np.log(1000.0)
    assert price([friction, friction], 1000.0) == pytest.approx(2.0 * one)
    assert price(stribeck[:1], 1000.0) == pytest.approx(one + np.log(1000.0) + 2.0 * np.log(3.0))
    assert price([], 1000.0) == 0.0


@pytest.mark.parametrize(("time_s", "within_s"), [(6.3, 3.0), (14.6, 5.0)])
def test_what_grows_over_a_while_is_found_though_a_step_of_it_would_ring(time_s: float, within_s: float) -> None:
    web = Ringing(time_s, 9.0, within_s, ringing=0.5)
    found = search(FreeRules(web.space, web.proposer()))
    assert named(found) == ["elasticity_ramp"]
    values = found.fit.terms[0].values
    assert values["time_s"] == pytest.approx(time_s, abs=0.11)  # two periods of the ringing
    assert values["duration_s"] == pytest.approx(within_s, abs=0.2)
    assert values["relative_change"] == pytest.approx(9.0, rel=0.02)
