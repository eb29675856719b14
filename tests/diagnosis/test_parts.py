"""The parts of the diagnosis, each against what is known of it in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from tests.plant.models import DEMONSTRATOR, effect, lone_axis, model
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.diagnosis import Value
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.noise import floor, repeats, whitening
from hilbench.diagnosis.proposals import Proposer, peaks
from hilbench.diagnosis.residual_analysis import Condition, largest_ratio, located, misfits
from hilbench.diagnosis.space import Split
from hilbench.diagnosis.stretched_problem import StretchedProblem
from hilbench.diagnosis.terms import Term, extended, pack_with
from hilbench.diagnosis.web_line.free_run import FreeRun, between
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import effects_of, find_effect
from hilbench.plant.model_file import write_model
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.plant.web_line.parameters import ModelParameters, load_model


def term(effect_id: str, axis: int | None, **values: float) -> Term:
    found = find_effect(effect_id)
    return Term(
        found, axis, 0, {**found.filled({}), **values}, found.filled({}), {"order": 1e-3, "speed_m_s": 1e-3}, 1.0
    )


@given(st.floats(1e-6, 1e-3), st.floats(-3.1, 3.1))
def test_amplitude_and_phase_survive_their_two_components(amplitude_m: float, phase: float) -> None:
    made = term("roller_eccentricity", 2, amplitude_m=amplitude_m, phase_rad=phase)
    again = made.at(made.coordinates())
    assert again.values == pytest.approx(made.values, rel=1e-9)


@given(st.floats(0.01, 5.0), st.floats(0.1, 3.0), st.floats(0.5, 9.0))
def test_the_gradient_is_that_of_the_named_parameters(amplitude: float, phase: float, order: float) -> None:
    made = term("torque_ripple", 1, amplitude_Nm=amplitude, phase_rad=phase, order=order)
    here, gradient = made.coordinates(), made.gradient()
    for k in range(len(here)):
        step = np.zeros(len(here))
        step[k] = 1e-6
        moved, back = made.at(here + step), made.at(here - step)
        expected = [(moved.values[name] - back.values[name]) / 2e-6 for name in made.free()]
        assert gradient[:, k] == pytest.approx(expected, rel=1e-4, abs=1e-6)


def test_parts_of_an_effect_are_terms_of_their_own_and_one_effect_of_the_model() -> None:
    fed = find_effect("feed_forward")
    terms = [
        Term(fed, 1, 0, {**fed.filled({}), name: 0.5}, fed.filled({}), {}, 0.1, part=name) for name in fed.strength
    ]
    assert [t.free() for t in terms] == [[name] for name in fed.strength]
    assert len({t.key for t in terms}) == 3
    plain = model(effect("feed_forward", 1, inertia_share=0.2))
    found = extended(plain, terms[:2])
    assert [(e.effect, e.parameters) for e in found.effects] == [
        ("feed_forward", {"inertia_share": 0.5, "viscous_share": 0.5})
    ]
    assert np.array_equal(lay.pack(found), pack_with(plain, terms[:2]))


def test_a_strength_is_kept_within_its_bounds() -> None:
    made = term("coulomb_friction", 1, force_N=1.0)
    assert made.at(np.array([-2.0])).values["force_N"] == 0.0
    assert not made.allowed(-2.0)
    assert term("torque_offset", 1, offset_Nm=0.1).allowed(-2.0)


def test_an_extended_model_is_a_model_file_that_runs_with_what_was_there(tmp_path) -> None:
    base = model(effect("coulomb_friction", 2, force_N=2.0), effect("torque_ripple", 1, amplitude_Nm=0.1, order=3.0))
    ripple = Term(
        find_effect("torque_ripple"), 1, 1, {"amplitude_Nm": 0.2, "order": 7.0, "phase_rad": 0.0}, {}, {}, 1.0
    )
    found = extended(base, [term("coulomb_friction", 2, force_N=5.0), ripple])
    write_model(tmp_path / "m.yaml", found)
    again = load_model(tmp_path / "m.yaml")
    assert [(e.effect, e.axis) for e in again.effects] == [
        ("coulomb_friction", 2),
        ("torque_ripple", 1),
        ("torque_ripple", 1),
    ]
    assert again.effects[0].parameters["force_N"] == 5.0
    assert np.array_equal(lay.pack(again), pack_with(base, [term("coulomb_friction", 2, force_N=5.0), ripple]))


def test_the_floor_is_the_noise_whatever_moves_and_jumps() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(20000) * 0.002
    signal = 3.0 * np.sin(t) + np.where(t > 20.0, 5.0, 0.0)
    for sd in (0.05, 2e-7):
        assert floor(signal + sd * rng.standard_normal(len(t))) == pytest.approx(sd, rel=0.03)
    quantized = np.round((signal + 0.05 * rng.standard_normal(len(t))) / 0.005) * 0.005
    assert floor(quantized) == pytest.approx(0.05, rel=0.03)


def test_whitened_noise_is_white_of_variance_one() -> None:
    rng = np.random.default_rng(0)
    coloured = lfilter([1.0], [1.0, -0.9], rng.standard_normal((1, 50000)))
    white = whitening(coloured).apply(coloured)[0, 100:]
    assert np.var(white) == pytest.approx(1.0, rel=0.03)
    for lag in (1, 2, 5):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 0.02
    # (1 + rho)/(1 - rho) samples of an AR(1) count as one.
    assert repeats(coloured[0]) == pytest.approx(19.0, rel=0.25)


def test_peaks_are_found_at_any_order_of_an_angle_that_runs_unevenly() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(30000) * 0.002
    turns = np.cumsum(2.0 + np.sin(0.1 * t)) * 0.002
    signal = 0.15 * np.sin(2.0 * np.pi * 3.25 * turns + 0.4) + rng.standard_normal(len(t))
    found, count = peaks(turns, signal[None, :], 64.0)
    assert found[0] == pytest.approx(3.25, abs=0.5 / np.ptp(turns))
    assert count > 1000


def test_the_linear_problem_gives_least_squares_of_the_training_blocks() -> None:
    rng = np.random.default_rng(0)
    columns, noise = rng.standard_normal((3, 2, 12000)), rng.standard_normal((2, 12000))
    residual = 0.5 * columns[0] - 0.2 * columns[2] + noise
    split = Split.of(np.ones(12000, bool), 0.002)
    assert 0.2 < np.mean(split.test) < 0.35
    assert not np.any(split.train & split.test)
    problem = StretchedProblem.of(residual[:, split.train], columns[:, :, split.train])
    left, theta = problem.left([0, 2])
    a = columns[[0, 2]][:, :, split.train].reshape(2, -1)
    b = residual[:, split.train].reshape(-1)
    expected, least, _, _ = np.linalg.lstsq(a.T, b, rcond=None)
    assert theta == pytest.approx(expected, rel=1e-6)
    assert left == pytest.approx(least[0], rel=1e-6)
    assert problem.left_with([], [0, 2], theta) == pytest.approx(left, rel=1e-6)


def test_the_stretch_in_which_a_signal_changes_is_not_held_out() -> None:
    rows, signal = np.ones(6000, bool), np.zeros((1, 6000))
    for first in range(0, 6000, 600):
        signal[:] = 0.0
        signal[0, first : first + 400] = 1.0
        split = Split.balanced(signal, rows, 0.01)
        assert np.sum(signal[0, split.train]) > np.sum(signal[0, split.test])


@pytest.mark.parametrize("first", range(100, 5900, 450))
def test_where_alone_the_model_disagrees_is_not_held_out(first: int) -> None:
    rng = np.random.default_rng(first)
    rows, steady = np.ones(6000, bool), np.sin(0.05 * np.arange(6000))[None]
    residual = rng.standard_normal((2, 6000))
    residual[1, first : first + 90] *= 4.0
    split = Split.balanced(steady, rows, 0.01, residual=residual)
    assert np.count_nonzero(split.train[first : first + 90]) > 45
    usual = Split.balanced(steady, rows, 0.01)
    noise_alone = Split.balanced(steady, rows, 0.01, residual=rng.standard_normal((2, 6000)))
    assert np.array_equal(noise_alone.block, usual.block)


def test_an_axis_that_moves_for_a_short_while_has_rows_on_both_sides() -> None:
    rows = np.zeros(60000, bool)
    rows[1000:5000] = True
    split = Split.balanced(np.sin(0.01 * np.arange(60000))[None], rows, 0.001)
    assert np.count_nonzero(split.train) > 1000
    assert np.count_nonzero(split.test) > 500


def test_rows_behind_a_standstill_count_where_no_filter_remembers_it() -> None:
    rows = np.ones(400, bool)
    rows[:60] = rows[200:210] = False
    counted = Split.of(rows, 0.1).block >= 0
    remembered = Split.of(rows, 0.1, memory=24).block >= 0
    assert counted[210]
    assert not np.any(remembered[210:234])
    assert np.array_equal(counted[240:], remembered[240:])


def test_few_rows_of_noise_are_not_more_than_noise() -> None:
    rng = np.random.default_rng(1)
    for count in (100, 1000, 20000):
        rows = np.ones(count, bool)
        worst = max(float(np.sqrt(np.mean(rng.standard_normal(count) ** 2))) for _ in range(200))
        assert worst < largest_ratio(rows) < 1.5
    assert largest_ratio(np.ones(100000, bool)) < 1.06


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_noise_alone_is_no_misfit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 8000
    t = np.arange(n) * 0.002
    conditions = [Condition("time", "s", t, spectral=True), Condition("angle", "m", 3.0 * t, period=1.2, spectral=True)]
    found = misfits(("tau",), rng.standard_normal((1, n)), np.ones(n, bool), conditions)
    assert not any(m.significant for m in found)


@pytest.mark.parametrize(("deviations", "significant"), [(5.0, False), (7.0, True)])
def test_what_depends_on_an_angle_is_a_misfit_from_six_deviations_of_chance_on(
    deviations: float, significant: bool
) -> None:
    """Chi-square of 24 bins has a variance of 48; 15 more are asked for."""
    bins, n = 24, 9600
    angle = (np.arange(n) + 0.5) / n
    excess = deviations * np.sqrt(2.0 * bins) + 15.0
    r = np.sqrt((excess + bins) / n) * np.where((angle * bins).astype(int) % 2, 1.0, -1.0)
    (found, *_) = [
        each
        for each in misfits(("tau",), r[None, :], np.ones(n, bool), [Condition("angle", "m", angle, period=1.0)])
        if each.condition == "angle"
    ]
    assert found.excess == pytest.approx(excess)
    assert found.significant is significant


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("frequency", lambda t: 0.2 * np.sin(2.0 * np.pi * 7.0 * t)),
        ("angle", lambda t: 0.2 * np.cos(2.0 * np.pi * 2.5 * t)),
        ("time", lambda t: np.where(t > 9.0, 0.2, 0.0)),
        ("burst in time", lambda t: np.where((t > 5.0) & (t < 5.4), 2.0 * np.sin(300.0 * t), 0.0)),
    ],
)
def test_a_misfit_is_seen_against_what_it_depends_on(name, shape) -> None:
    t = np.arange(10000) * 0.002
    r = np.random.default_rng(0).standard_normal(len(t)) + shape(t)
    conditions = [Condition("time", "s", t, spectral=True), Condition("angle", "m", 3.0 * t, period=1.2)]
    found = misfits(("tau",), r[None, :], np.ones(len(t), bool), conditions)
    assert name in [m.condition for m in found if m.significant]


def test_the_required_torque_of_a_lone_axis_is_newtons() -> None:
    axis = lone_axis(
        effect("viscous_friction", 1, coefficient_N_s_per_m=4.0),
        effect("coulomb_friction", 1, force_N=2.0),
        effect("torque_offset", 1, offset_Nm=0.3),
        effect("torque_scale", 1, relative_change=0.1),
        effect("inertia_mismatch", 1, relative_change=0.5),
    )
    t = np.linspace(0.0, 5.0, 501)
    x, v, a = np.sin(t), np.cos(t), -np.sin(t)
    out = np.empty(len(t))
    required_torque_Nm(lay.pack(axis), x, v, a, 0.01, out)
    expected = (3.0 * 1.5 * a + 4.0 * v + 2.0 * np.clip(v / 1e-3, -1.0, 1.0)) / 1.1 + 0.3
    assert out == pytest.approx(expected, rel=1e-9)


def test_proposals_cover_the_vocabulary() -> None:
    plain = model()
    data = measured_from(hidden_recording(plain, [], duration_s=10.0), plain, "blind")
    made = Proposer(plain, data)
    ids = {t.effect.id for t in made.direct()} | {
        t.effect.id for t in made.onsets(find_effect("elasticity_step"), made.onset_times_s()[0], [])
    }
    noise = {name: np.random.default_rng(0).standard_normal(5000) for name in ("tau1_Nm", "tau2_Nm")}
    ids |= {t.effect.id for t in made.searched(noise, [], 1)}
    ids |= {t.effect.id for t in made.gradual(find_effect("elasticity_step"), 3.0, 2.0, [])}
    ids |= {t.effect.id for effect in made.passing() for t in made.onsets(effect, np.array([3.0]), [])}
    assert ids == {e.id for e in effects_of(MachineKind.WEB_LINE) if not e.nuisance}


def test_a_lone_axis_has_no_effects_of_a_web() -> None:
    axis = ModelParameters.model_validate({"rollers": {"radius_m": 1.0, "inertia_kg_m2": 3.0}})
    assert EffectEntry(effect="coulomb_friction", axis=1, parameters={"force_N": 1.0})
    plain = model()
    data = measured_from(hidden_recording(plain, [], duration_s=10.0), plain, "blind")
    assert {t.effect.per_axis for t in Proposer(axis, data).direct()} == {True}


@given(st.lists(st.floats(-3.0, 3.0), min_size=4, max_size=8), st.integers(2, 10), st.integers(0, 2**32 - 1))
def test_corners_between_the_rows_of_ramps_are_found(levels: list[float], whole: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = whole * 10 * np.arange(len(levels)) + rng.integers(0, whole, len(levels))
    fine = np.interp(np.arange(corners[-1] // whole * whole), corners, levels)
    rows = fine[::whole, None]
    assert between(rows, whole)[:-1].reshape(-1) == pytest.approx(fine[:-whole], abs=1e-9)


def test_steps_between_rows_stay_within_their_rows() -> None:
    rows = np.array([0.0, 0.0, 1.0, 1.0, 0.0])[:, None]
    found = between(rows, 5)
    assert np.all((found >= -1e-12) & (found <= 1.0 + 1e-12))
    assert found[:, 0, 0] == pytest.approx(rows[:, 0])


def test_shares_of_a_gap_are_parts_of_one_whole() -> None:
    n = 10000
    t = np.arange(n) * 0.002
    v = np.interp(t, [0.0, 5.0, 10.0, 20.0], [0.0, 3.0, 3.0, 1.0])
    conditions = [
        Condition("time", "s", t, spectral=True),
        Condition("speed", "m/s", v),
        Condition("tension", "N", 80.0 + v),
        Condition("angle", "rad", np.cumsum(v) * 0.05, period=2.0 * np.pi, spectral=True),
    ]
    r = np.random.default_rng(0).standard_normal((2, n)) + np.array([1.5, 0.7])[:, None] * v
    found = located(("tau1", "tau2"), r, np.ones(n, bool), conditions, 8)
    assert found[0][1] > 0.5
    assert sum(share for _, share in found) <= 1.0 + 1e-9
    assert [share for _, share in found] == sorted((share for _, share in found), reverse=True)


def test_a_place_of_a_misfit_is_never_an_empty_interval() -> None:
    n = 8000
    speed = np.where(np.arange(n) < 2000, 1.0, 3.0 + 1e-5 * np.linspace(0.0, 1.0, n))
    r = np.random.default_rng(0).standard_normal((1, n)) + np.where(np.arange(n) < 2000, 2.0, 0.0)
    for m in misfits(
        ("tau",), r, np.ones(n, bool), [Condition("time", "s", np.arange(n) * 0.002), Condition("speed", "m/s", speed)]
    ):
        if "largest at" in m.detail:
            low, high = m.detail.removeprefix("largest at ").split(" ")[0:3:2]
            assert float(low) < float(high)


def test_a_change_that_lasts_is_located_from_its_onset_on() -> None:
    n = 8000
    t = np.arange(n) * 0.002
    noise = np.random.default_rng(0).standard_normal((1, n))
    lasting = located(("tau",), noise + np.where(t < 5.0, 0.0, 2.0), np.ones(n, bool), [Condition("time", "s", t)], 1)
    onset = lasting[0][0].detail
    assert onset.startswith("from ")
    assert abs(float(onset.split()[1]) - 5.0) < 0.05
    passing = np.where((t > 5.0) & (t < 9.0), 2.0, 0.0)
    for other in (passing, np.full(n, 2.0)):
        found = located(("tau",), noise + other, np.ones(n, bool), [Condition("time", "s", t)], 1)
        assert found[0][0].detail.startswith("largest at")


def test_what_passes_is_looked_for_where_a_while_stands_out_and_nowhere_else() -> None:
    plain = model()
    data = measured_from(hidden_recording(plain, [], duration_s=12.0), plain, "blind")
    made, rng = Proposer(plain, data), np.random.default_rng(0)
    noise = {name: rng.standard_normal(6000) for name in ("tau1_Nm", "tau2_Nm")}
    rows = np.ones(6000, bool)
    assert not len(made.passage_times_s(noise, rows)[0])
    noise["tau2_Nm"][3000:3150] += 3.0
    times, apart_s = made.passage_times_s(noise, rows)
    assert np.min(np.abs(times - 6.0)) < apart_s
    assert np.ptp(times) < 2.0


def test_no_ripple_is_proposed_whose_period_the_recording_does_not_hold() -> None:
    plain = model()
    data = measured_from(hidden_recording(plain, [], duration_s=12.0), plain, "blind")
    turns = np.ptp(data.x_m[1]) * plain.motor_rad_per_m(1) / (2.0 * np.pi)
    slow = np.sin(2.0 * np.pi * data.x_m[1] * plain.motor_rad_per_m(1) / (2.0 * np.pi) * 0.5 / turns)
    noise = dict.fromkeys(("tau1_Nm", "tau2_Nm"), 50.0 * slow)
    made = [t for t in Proposer(plain, data).searched(noise, [], 1) if t.effect.id == "torque_ripple"]
    assert made
    for term in made:
        assert term.values["order"] >= 0.5 / plain.gear_ratio(1)
        assert term.at(np.array([0.1, 0.1, 1e-3])).values["order"] >= 4.0 / turns


@pytest.mark.parametrize(
    ("low", "high"),
    [(10.0, 10.004), (0.2066, 0.2072), (-1.0, 1.0), (87012.3, 87012.9), (-3.0012, -3.0011), (0.0, 2e-6)],
)
def test_both_ends_of_an_interval_are_shown_as_different_numbers(low: float, high: float) -> None:
    digits = Value(0.5 * (low + high), (low, high), "1").digits
    assert f"{low:.{digits}g}" != f"{high:.{digits}g}"
    assert float(f"{high:.{digits}g}") - float(f"{low:.{digits}g}") == pytest.approx(high - low, rel=0.5)


def test_positions_are_believed_to_a_share_of_what_the_web_is_stretched_by() -> None:
    """On the demonstrator 2 µm; a web that is stretched a fifth as much has to be known that much better."""
    stiff = {**DEMONSTRATOR["web"], "youngs_modulus_Pa": 5.0 * 8.7e9}
    found = []
    for plain in (model(), model(web=stiff)):
        data = measured_from(hidden_recording(plain, [], duration_s=6.0), plain, "blind")
        predictor = FreeRun(plain, data)
        found.append(dict(zip(predictor.names, predictor.tolerances, strict=True)))
    assert found[0]["x1_m - x2_m"] == pytest.approx(2e-6, rel=0.02)
    assert found[1]["x1_m - x2_m"] == pytest.approx(0.2 * found[0]["x1_m - x2_m"])
    assert found[0]["tau2_Nm"] == 0.0


def test_unbalance_is_proposed_at_every_axis_and_shows_in_the_torque_a_lone_axis_needs() -> None:
    axis = lone_axis(effect("unbalance", 1, amplitude_Nm=2.0, phase_rad=0.3))
    x = np.linspace(0.0, 10.0, 501)
    out = np.empty(len(x))
    required_torque_Nm(lay.pack(axis), x, np.zeros(len(x)), np.zeros(len(x)), 0.01, out)
    assert out == pytest.approx(-2.0 * np.sin(x + 0.3))
    data = measured_from(hidden_recording(model(), [], duration_s=6.0), model(), "blind")
    assert [t.axis for t in Proposer(model(), data).direct() if t.effect.id == "unbalance"] == [1, 2]
