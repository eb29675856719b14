"""Fits of chosen terms, against what is known of them in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.diagnosis.analytic import NOISE, PERIOD_S, Axis, Ringing
from tests.plant.models import effect

from hilbench.diagnosis.fit import fit, sums, with_best_time
from hilbench.diagnosis.noise import scaling
from hilbench.diagnosis.terms import Term
from hilbench.plant.effects import find_effect

#: Fall of the sum of squares that is not worth another step.
ENOUGH = 0.3
WHITE = scaling(np.array([NOISE]))
COULOMB = effect("coulomb_friction", 1, force_N=2.0)
VISCOUS = effect("viscous_friction", 1, coefficient_N_s_per_m=1.5)


def test_a_fit_of_linear_effects_is_least_squares_on_the_rows_that_it_may_see() -> None:
    axis = Axis(VISCOUS, effect("torque_offset", 1, offset_Nm=-0.3))
    terms = [axis.term("viscous_friction"), axis.term("torque_offset")]
    found = fit(axis.space, WHITE, terms)
    seen = axis.space.split.train
    assert 0.4 < np.mean(seen) < 0.8
    columns = np.column_stack([axis.v_m_s, np.ones(len(axis.t_s))])[seen] / NOISE
    residual = axis.space.residual([])[0, seen] / NOISE
    expected, squares, _, _ = np.linalg.lstsq(columns, residual, rcond=None)
    values = [term.coordinates()[0] for term in found.terms]
    covariance = np.linalg.inv(columns.T @ columns)
    assert np.all(np.abs(values - expected) < 0.6 * np.sqrt(np.diag(covariance)))
    assert squares[0] <= found.train * (1.0 + 1e-12) <= squares[0] + ENOUGH
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-4)
    assert (found.train, found.test) == pytest.approx(sums(axis.space, WHITE, found.residual))


def test_a_fit_on_other_rows_sees_those_and_no_more() -> None:
    axis = Axis(COULOMB)
    early = np.arange(len(axis.t_s)) < 1000
    found = fit(axis.space, WHITE, [axis.term("viscous_friction")], early)
    v, r = axis.v_m_s[early], axis.space.residual([])[0, early]
    deviation = NOISE / np.sqrt(v @ v)
    assert found.terms[0].coordinates()[0] == pytest.approx(v @ r / (v @ v), abs=0.6 * deviation)
    other, s = axis.v_m_s[~early], axis.space.residual([])[0, ~early]
    assert abs(v @ r / (v @ v) - other @ s / (other @ other)) > 10.0 * deviation


@settings(max_examples=15, deadline=None)
@given(
    st.floats(0.0, 5.0),
    st.floats(0.0, 5.0),
    st.sampled_from(["inertia_mismatch", "torque_scale", "friction_asymmetry"]),
)
def test_no_fit_is_worse_than_where_it_began(force_N: float, coefficient: float, other: str) -> None:
    axis = AXIS
    start = [
        axis.term("coulomb_friction", force_N=force_N),
        axis.term("viscous_friction", coefficient_N_s_per_m=coefficient),
        axis.term(other),
    ]
    before, _ = sums(axis.space, WHITE, axis.space.residual(start))
    found = fit(axis.space, WHITE, start)
    assert found.train <= before
    assert [term.key for term in found.terms] == [term.key for term in start]


AXIS = Axis(COULOMB, VISCOUS, effect("inertia_mismatch", 1, relative_change=0.2))


def test_no_friction_drives() -> None:
    """The best friction would be negative: it ends at its bound."""
    axis = Axis()
    pushed = axis.space.predictor.measured - 3.0 * np.sign(axis.v_m_s)
    axis.space.predictor.measured = pushed
    found = fit(axis.space, WHITE, [axis.term("coulomb_friction", force_N=1.0)])
    assert found.terms[0].values["force_N"] == 0.0


@pytest.mark.parametrize("delay_s", [0.012, 0.03])
def test_a_delay_is_found_from_far_off(delay_s: float) -> None:
    ripple = effect("torque_ripple", 1, amplitude_Nm=2.0, order=60.0, phase_rad=0.0)
    axis = Axis(ripple, effect("torque_delay", 1, delay_s=delay_s), forward=True)
    base = Term(
        find_effect("torque_ripple"),
        1,
        0,
        {"amplitude_Nm": 2.0, "order": 60.0, "phase_rad": 0.0},
        {"amplitude_Nm": 0.0, "order": 60.0, "phase_rad": 0.0},
        {"order": 1e-4},
        0.1,
    )
    probes = axis.proposer("torque_delay").direct()
    assert len(probes) == 4
    best = min((fit(axis.space, WHITE, [base, probe]) for probe in probes), key=lambda found: found.train)
    assert best.terms[1].values["delay_s"] == pytest.approx(delay_s, abs=1e-4)


def test_a_fit_that_can_not_reach_what_is_asked_is_given_up_early() -> None:
    """A delay, of which many strengths are tried, is not searched for once it has lost."""
    axis = Axis(COULOMB, effect("torque_ripple", 1, amplitude_Nm=1.0, order=3.0, phase_rad=0.3))
    wrong = [axis.proposer("torque_delay").direct()[0]]
    whole = fit(axis.space, WHITE, wrong)
    cost = axis.space.simulations
    given_up = fit(axis.space, WHITE, wrong, worth=0.5 * whole.train)
    assert 2 * (axis.space.simulations - cost) < cost
    assert given_up.train >= whole.train


def test_a_model_that_runs_away_is_no_explanation() -> None:
    axis = Axis()
    axis.space.predictor.predict = lambda parameters: np.full(
        (len(np.atleast_2d(parameters)), 1, len(axis.t_s)), np.nan
    )  # type: ignore[method-assign]
    found = fit(axis.space, WHITE, [axis.term("coulomb_friction", force_N=1.0)])
    assert found.train == float("inf")
    assert found.test == float("inf")


@pytest.mark.parametrize("off_s", [-0.27, -0.06, 0.11, 0.29])
def test_the_time_of_a_step_is_found_though_every_period_of_a_ringing_is_a_minimum(off_s: float) -> None:
    web = Ringing(time_s=12.34, change=0.2)
    step = find_effect("elasticity_step")
    base = step.filled({})
    start = Term(step, None, 0, {"time_s": 12.34 + off_s, "relative_change": 0.05}, base, {"time_s": 0.01}, 0.1)
    (found,) = with_best_time(web.space, WHITE, [start], 0)
    assert found.aimed
    assert found.time_s == pytest.approx(12.34, abs=PERIOD_S)
    assert found.values["relative_change"] == pytest.approx(0.2, rel=0.05)
