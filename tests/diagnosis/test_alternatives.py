"""What is tried in the place of a term, and from where."""

from __future__ import annotations

import pytest
from tests.diagnosis.analytic import Axis, Ringing
from tests.plant.models import effect, model
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.fit import fit
from hilbench.diagnosis.free_rules import FreeRules
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Place
from hilbench.diagnosis.web_line.free_run import FreeRun
from hilbench.plant.parameters import EffectEntry


@pytest.mark.parametrize(("rough_Nm", "difference"), [(0.05, 0.4), (0.1, 2.0)])
def test_what_acts_the_same_is_found_though_the_sum_of_squares_is_rough(rough_Nm: float, difference: float) -> None:
    """Forward only, b·v and d·|v| are one; a fit that goes downhill from a strength beside the right one gets stuck."""
    hidden = effect("friction_asymmetry", 1, viscous_difference_N_s_per_m=difference)
    axis = Axis(hidden, forward=True, rough_Nm=rough_Nm)
    steps = FreeRules(axis.space, axis.proposer("friction_asymmetry", "viscous_friction", "torque_offset"))
    terms = [axis.term("friction_asymmetry", viscous_difference_N_s_per_m=difference)]
    offered = steps.candidates(steps.fit_of(terms))
    found, tied, _ = steps.tested(fit(axis.space, offered.whitening, terms), offered)
    (term,) = found.terms
    assert term.place == Place("viscous_friction", 1)
    assert term.coordinates() == pytest.approx([difference], rel=1e-3)
    assert tied[term.key] == [Place("friction_asymmetry", 1)]


def test_orders_of_a_web_are_tried_at_the_nearest_whole_number_as_well() -> None:
    """A ripple that shows in a few turns far apart has side peaks, from which no fit comes to the right one."""
    ripple = EffectEntry.model_validate(effect("torque_ripple", 1, amplitude_Nm=0.1, order=6.0, phase_rad=0.4))
    data = measured_from(hidden_recording(model(), [ripple], duration_s=12.0, seed=3), model(), "blind")
    predictor = FreeRun(model(), data)
    steps = FreeRules(Space(model(), predictor, data.period_s), Proposer(model(), data))
    candidates = steps.candidates(steps.fit_of([])).candidates
    orders = [term.values["order"] for term in candidates if term.place == Place("torque_ripple", 1)]
    assert 6.0 in orders
    assert any(0.0 < abs(order - 6.0) < 0.1 for order in orders)


def test_a_ramp_that_becomes_a_step_when_another_term_goes_has_columns_of_its_own() -> None:
    """A gradual change has a coordinate more than the sudden one that takes its place."""
    web = Ringing(time_s=10.0, change=9.0)
    proposer = web.proposer()
    steps = FreeRules(web.space, proposer)
    offered = steps.candidates(steps.fit_of([]))
    ramp = next(term for term in offered.candidates if term.effect.id == "elasticity_ramp")
    step = next(term for term in offered.candidates if term.effect.id == "elasticity_step")
    ramp = ramp.at(ramp.coordinates({**ramp.values, "time_s": 9.975, "duration_s": 0.05, "relative_change": 9.0}))
    nothing = step.at(step.coordinates({**step.values, "time_s": 3.0, "relative_change": 0.001}))
    current = fit(web.space, offered.whitening, [nothing, ramp])
    found, _, _ = steps.tested(current, steps.candidates(current))
    assert [term.effect.id for term in found.terms] == ["elasticity_step"]
