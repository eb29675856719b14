"""Diagnosis on measured motion: what is certain of an axis on which something is always left unexplained."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests import independent
from tests.diagnosis.analytic import Axis
from tests.diagnosis.axis_rig import Rig, axis_model
from tests.plant.models import effect
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.measured_motion import MotionFilter, OnMeasuredMotion, known_to_Hz
from hilbench.diagnosis.residual_noise import Uncertainty, uncertainty, with_guess, with_noisy_columns
from hilbench.diagnosis.search import search
from hilbench.diagnosis.select_measured import MeasuredRules
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Place
from hilbench.plant.effects import find_effect
from hilbench.results.recording import Recording, read_recording

SMOOTH = ("coulomb_friction", "viscous_friction", "friction_asymmetry", "torque_offset", "inertia_mismatch")
#: Of the servo axis beside the checkout: plain, and with inertia, friction and dry friction fed forward as well.
SERVO = {
    "Jm": {"coulomb_friction", "viscous_friction", "torque_offset", "inertia_mismatch", "torque_ripple"},
    "Bm": {"coulomb_friction", "viscous_friction", "torque_offset", "inertia_mismatch", "torque_ripple"},
    "Fc": {"coulomb_friction", "torque_offset", "inertia_mismatch", "torque_ripple"},
    "Fs": {"inertia_mismatch", "torque_ripple"},
}


@cache
def repeats() -> list[Recording]:
    return Rig().recordings(4)


def names(found: Diagnosis) -> set[str]:
    return {item.effect for item in found.effects}


def value(found: Diagnosis, name: str) -> float:
    (item,) = (item for item in found.effects if item.effect == name)
    return item.parameters[find_effect(name).strength[0]].value


def neutral_in_an_interval(found: Diagnosis) -> list[str]:
    """Effects of which the interval of the strength contains what a model without the effect has."""
    inside = []
    for item in found.effects:
        row = find_effect(item.effect)
        for name in row.strength:
            low, high = item.parameters[name].ci95
            if low <= row.parameter(name).neutral <= high:
                inside.append(item.effect)
    return inside


def test_of_a_short_run_there_and_back_fits_see_a_good_part_of_each_direction() -> None:
    t = 0.001 * np.arange(5500)
    v = np.interp(t, [0.0, 3.5, 5.5], [45.0, -60.0, 0.0])  # forward for a second and a half, then back
    torque = 0.03 * np.sign(v) + 1e-3 * np.random.default_rng(4).standard_normal(len(t))
    model = axis_model(1e-4)
    data = measured_from(Recording({"t_s": t, "x1_m": np.cumsum(v) * 0.001, "tau1_Nm": torque}), model, "short")
    predictor = OnMeasuredMotion(model, data)
    split = Space(model, predictor, data.period_s).split
    for forward in (True, False):
        presliding_travel = ((v > 0.0) == forward)[:: predictor.every] & predictor.rows
        assert np.count_nonzero(split.train & presliding_travel) > 0.4 * np.count_nonzero(presliding_travel)
        assert np.count_nonzero(split.test & presliding_travel) > 0.1 * np.count_nonzero(presliding_travel)


@pytest.mark.slow
@pytest.mark.parametrize("known_inertia_kg_m2", [1e-4, 1.66e-4])
def test_repeats_of_one_motion_of_an_axis_have_the_same_names_and_values(known_inertia_kg_m2: float) -> None:
    rig = Rig()
    for recording in repeats():
        found = diagnose(recording, axis_model(known_inertia_kg_m2), "blind")
        assert found.verdict == "named"
        assert names(found) == SERVO["Jm"]
        assert neutral_in_an_interval(found) == []
        assert value(found, "coulomb_friction") == pytest.approx(rig.coulomb_Nm, rel=0.05)
        assert value(found, "viscous_friction") == pytest.approx(rig.viscous_Nm_s, rel=0.08)
        assert value(found, "torque_offset") == pytest.approx(rig.offset_Nm, rel=0.1)
        assert value(found, "inertia_mismatch") == pytest.approx(
            rig.inertia_kg_m2 / known_inertia_kg_m2 - 1.0, abs=0.06
        )
        (ripple,) = (item for item in found.effects if item.effect == "torque_ripple")
        assert ripple.parameters["order"].value == 5.0


@pytest.mark.slow
def test_what_is_certain_is_listed_beside_a_rest_that_no_effect_explains() -> None:
    (recording,) = Rig(spring_Nm=1e-3).recordings(1)
    found = diagnose(recording, axis_model(1.66e-4), "blind")
    assert found.verdict == "unknown"
    assert "coulomb_friction" in names(found)
    assert neutral_in_an_interval(found) == []
    assert {entry.effect for entry in found.model.effects} == names(found)
    assert found.unexplained


@pytest.mark.slow
def test_the_noise_of_an_encoder_does_not_make_an_inertia_smaller() -> None:
    """A coarse encoder takes a narrower filter; a fixed one would let its counts into the acceleration."""
    fine, coarse = (Rig(counts_per_turn=counts).recordings(1, seed=3)[0] for counts in (100_000, 2_000))
    corners = []
    for recording in (fine, coarse):
        found = diagnose(recording, axis_model(1e-4), "blind")
        assert value(found, "inertia_mismatch") == pytest.approx(1.0, abs=0.06)
        corners.append(MotionFilter.widest(np.asarray(recording["x1_m"]), 0.001).corner_hz)
    assert corners[1] < 0.6 * corners[0]


def swinging(count_rad: float, *, order: float = 4.0, amplitude_Nm: float = 0.0, seconds: float = 12.0) -> Recording:
    """A direct drive of 1 kg·m² that swings over a turn and a half, by an encoder with counts."""
    t = 0.001 * np.arange(round(1000.0 * seconds))
    x = 1.5 * np.pi * np.sin(2.2 * t) * (0.9 + 0.1 * np.sin(0.31 * t))
    v = np.gradient(x, 0.001)
    torque = np.gradient(v, 0.001) + 1.7 * np.sign(v) + 3.0 + amplitude_Nm * np.sin(order * x + 0.8)
    torque += 0.02 * np.random.default_rng(7).standard_normal(len(t))
    return Recording({"t_s": t, "x1_m": np.round(x / count_rad) * count_rad, "tau1_Nm": torque})


def test_a_ripple_over_hardly_more_than_a_turn_is_named_with_its_order() -> None:
    found = diagnose(swinging(6e-6, amplitude_Nm=4.7), axis_model(1.0), "few turns")
    assert found.verdict == "named"
    assert names(found) == {"coulomb_friction", "torque_offset", "torque_ripple"}
    (ripple,) = (item for item in found.effects if item.effect == "torque_ripple")
    assert ripple.parameters["order"].value == pytest.approx(4.0, abs=0.01)
    assert ripple.parameters["amplitude_Nm"].value == pytest.approx(4.7, rel=0.02)


def test_the_counts_of_an_encoder_end_the_band_in_which_a_resonance_is_looked_for() -> None:
    t = 0.001 * np.arange(10_000)
    v = np.interp(t % 2.0, [0.0, 0.2, 0.8, 1.2, 1.8, 2.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    x = np.cumsum(v) * 0.001
    fine, usual, coarse = (known_to_Hz(np.round(x / count) * count, 0.001, 2) for count in (1e-6, 1e-4, 1e-3))
    assert fine > 2.0 * usual > 4.0 * coarse
    assert fine < 60.0


@pytest.mark.slow
def test_intervals_hold_with_a_rest_of_any_colour() -> None:
    """Least squares with red, white and narrow-band noise: 95 % intervals hold the truth in about 95 %."""
    rng = np.random.default_rng(5)
    n, seeds = 600, 400
    t = np.arange(n) / n
    columns = np.array([np.ones(n), 2.0 * t - 1.0, np.sign(np.sin(7.0 * t)), np.sin(40.0 * t)])[:, None, :]
    inside = 0
    for _ in range(seeds):
        white = rng.standard_normal(n + 200)
        red = np.convolve(white, np.exp(-np.arange(200) / 12.0), "valid")[:n] * 0.3
        noise = red + 0.5 * rng.standard_normal(n) + np.sin(120.0 * t + rng.uniform(0.0, 6.3))
        theta, *_ = np.linalg.lstsq(columns[:, 0].T, noise, rcond=None)
        known = uncertainty(columns, (noise - theta @ columns[:, 0])[None])
        inside += int(np.count_nonzero(np.abs(theta) <= known.deviations * known.quantiles(0.95)))
    assert 0.93 <= inside / (4 * seeds) <= 0.975


def test_intervals_hold_where_what_explains_is_measured_with_noise() -> None:
    """Noise pulls a coefficient to zero, and moves that of what goes nearly with it; the fit's own interval knows
    nothing of that."""
    rng = np.random.default_rng(7)
    n, seeds = 400, 200
    t = np.arange(n) / n
    swings = np.sin(40.0 * t)
    beside = swings + 0.15 * np.cos(9.0 * t)
    inside = plain = 0
    for _ in range(seeds):
        columns = np.array([swings + 0.05 * rng.standard_normal(n), beside])
        torque = 2.0 * swings + 1.0 * beside + 0.02 * rng.standard_normal(n)
        theta, *_ = np.linalg.lstsq(columns.T, torque, rcond=None)
        left = torque - theta @ columns
        whole = uncertainty(columns[:, None], left[None])
        alone = Uncertainty(whole.covariance[1:, 1:], whole.freedom[1:])
        noisy, explained = np.ones((1, 1, n)), np.full((1, n), theta[0])
        known = with_noisy_columns(alone, columns, left, noisy, explained)
        off = abs(float(theta[1]) - 1.0)
        inside += off <= float(known.deviations[0] * known.quantiles(0.95)[0])
        plain += off <= float(alone.deviations[0] * alone.quantiles(0.95)[0])
    assert inside >= 0.95 * seeds
    assert plain < 0.5 * seeds


def test_intervals_hold_beside_an_inertia_that_is_a_guess() -> None:
    """In a free swing gravity and inertia nearly make up for one another: of gravity beside a wrong inertia the rest
    alone says too little, as long as it is too large for that inertia to be named."""
    rng = np.random.default_rng(11)
    n, seeds = 400, 200
    t = np.arange(n) / n
    gravity, inertia = np.sin(40.0 * t), -np.sin(40.0 * t) + 0.2 * np.cos(23.0 * t)
    inside = plain = 0
    for _ in range(seeds):
        pushed = np.convolve(rng.standard_normal(n + 40), np.ones(40) / 40**0.5, "valid")[:n]
        torque = 3.0 * gravity + float(rng.normal(0.0, 1.0)) * inertia + 0.3 * pushed
        theta = float(gravity @ torque / (gravity @ gravity))
        columns, left = gravity[None, None], (torque - theta * gravity)[None]
        alone = uncertainty(columns, left)
        known = with_guess(alone, columns, left, inertia[None, None])
        inside += abs(theta - 3.0) <= float(known.deviations[0] * known.quantiles(0.95)[0])
        plain += abs(theta - 3.0) <= float(alone.deviations[0] * alone.quantiles(0.95)[0])
    assert inside >= 0.9 * seeds
    assert plain < 0.5 * seeds


def test_counts_between_the_rows_of_an_even_grid_are_noise_as_well() -> None:
    """A slow hand on a coarse encoder: rows a little off an even grid have parts of a count between held values."""
    rng = np.random.default_rng(4)
    even = np.arange(0.0, 20.0, 1e-3)
    uneven = even + np.concatenate([[0.0], rng.uniform(-2e-4, 2e-4, len(even) - 2), [0.0]])
    corners = []
    for t_s in (even, uneven):
        counted = 3e-3 * np.round((0.2 * np.sin(0.7 * t_s) + 0.02 * np.sin(2.3 * t_s)) / 3e-3)
        corners.append(MotionFilter.widest(np.interp(even, t_s, counted), 1e-3).corner_hz)
    assert corners[1] == pytest.approx(corners[0], rel=0.2)


def test_friction_is_found_beside_what_is_not_in_the_vocabulary() -> None:
    hidden = (
        effect("coulomb_friction", 1, force_N=2.0),
        effect("viscous_friction", 1, coefficient_N_s_per_m=3.0),
        effect("torque_offset", 1, offset_Nm=0.5),
    )
    axis = Axis(*hidden, exact=False)
    slow = 0.3 * np.sin(0.9 * axis.t_s) * np.cos(3.1 * axis.x_m)
    axis.space.predictor.measured = axis.space.predictor.measured + slow
    found = search(MeasuredRules(axis.space, axis.proposer(*SMOOTH)))
    values = {t.effect.id: t.values[t.effect.strength[0]] for t in found.fit.terms}
    assert {"coulomb_friction", "torque_offset", "viscous_friction"} <= values.keys()
    assert values["coulomb_friction"] == pytest.approx(2.0, rel=0.1)
    assert values["viscous_friction"] == pytest.approx(3.0, rel=0.1)


def test_where_no_fit_can_tell_two_effects_apart_they_are_tied() -> None:
    """Forward only, b·v and d·|v| are one, and dry friction is an offset."""
    axis = Axis(effect("viscous_friction", 1, coefficient_N_s_per_m=0.4), forward=True, exact=False)
    found = search(MeasuredRules(axis.space, axis.proposer(*SMOOTH)))
    (term,) = found.fit.terms
    assert term.effect.id == "viscous_friction"
    assert Place("friction_asymmetry", 1) in found.tied[term.key]


def test_in_one_direction_an_offset_either_way_is_tied_with_dry_friction() -> None:
    """More friction may be fed forward than there is, so that its sign says nothing."""
    for offset_Nm in (0.5, -0.5):
        axis = Axis(effect("torque_offset", 1, offset_Nm=offset_Nm), forward=True, exact=False)
        found = search(MeasuredRules(axis.space, axis.proposer(*SMOOTH)))
        (term,) = found.fit.terms
        both = {term.effect.id, *(place.effect for place in found.tied[term.key])}
        assert {"torque_offset", "coulomb_friction"} <= both


def test_a_filter_shifts_nothing_in_time() -> None:
    recording = repeats()[0]
    predictor = OnMeasuredMotion(axis_model(2e-4), measured_from(recording, axis_model(2e-4), "blind"))
    assert predictor.narrower.corner_hz == pytest.approx(0.5 * predictor.corner_hz)
    pulse = np.zeros(2001)
    pulse[1000] = 1.0
    assert int(np.argmax(MotionFilter(20.0, 0.001).smooth(pulse))) == 1000


@pytest.mark.parametrize(("kind", "repeat"), [("Jm", 1), *slow(("Jm", 3), ("Bm", 2), ("Fc", 1), ("Fs", 2))])
def test_a_real_servo_axis_has_its_friction_in_every_repeat(kind: str, repeat: int) -> None:
    path = independent.real(f"servo/{kind}_{repeat:02d}")
    found = diagnose(read_recording(path), axis_model(1.6588e-4), path)
    assert names(found) == SERVO[kind]
    assert neutral_in_an_interval(found) == []
    assert found.verdict == ("unknown" if kind == "Fs" else "named")
    # One motor: whatever is fed forward, its ripple is as large in every recording, within the intervals stated (12 %).
    of_motor = [item.parameters for item in found.effects if item.effect == "torque_ripple"]
    (first_order,) = (each["amplitude_Nm"].value for each in of_motor if each["order"].value == 5.0)
    assert first_order == pytest.approx(1.41e-3, rel=0.1)


@pytest.mark.parametrize("kind", ["Bm", *slow("Fc")])
def test_a_torque_that_is_recorded_late_moves_no_ripple_to_an_order_beside_its_own(kind: str) -> None:
    path = independent.real(f"servo/{kind}_01")
    recording, rows = read_recording(path), 2
    late = {name: np.asarray(values)[rows:] for name, values in recording.channels.items()}
    late["tau1_Nm"] = np.asarray(recording["tau1_Nm"])[:-rows]
    found = diagnose(Recording(late), axis_model(1.6588e-4), path)
    assert SERVO[kind] - {"torque_ripple"} <= names(found) <= SERVO[kind]
    orders = [item.parameters["order"].value for item in found.effects if "order" in item.parameters]
    assert all(order == round(order) for order in orders)


def test_at_a_speed_that_is_given_and_always_the_same_ripples_are_found_by_their_orders() -> None:
    """As a torque sensor's recording of a load bench, whose motion nobody recorded."""
    t = 0.001 * np.arange(12000)
    angle, noise = 2.0 * np.pi * t, 0.05 * np.random.default_rng(4).standard_normal(len(t))
    torque = 9.0 + 0.8 * np.sin(4.0 * angle + 0.3) + 0.3 * np.sin(24.0 * angle) + noise
    found = diagnose(
        Recording({"t_s": t, "v1_m_s": np.full(len(t), 2.0 * np.pi), "tau1_Nm": torque}), axis_model(1e-3), "bench"
    )
    ripples = {round(item.parameters["order"].value): item for item in found.effects if "order" in item.parameters}
    assert {4, 24} <= set(ripples)
    assert ripples[4].parameters["amplitude_Nm"].value == pytest.approx(0.8, rel=0.02)
    assert "inertia_mismatch" in {blind.effect for blind in found.unobservable}


def test_what_a_small_swing_about_a_steady_speed_needs_is_no_ripple() -> None:
    (recording,) = Rig(swing=(2.0, 5.0), about_rad_s=20.0).recordings(1, seed=1)
    found = diagnose(recording, axis_model(1.6e-4), "blind")
    assert names(found) == {"coulomb_friction", "viscous_friction", "inertia_mismatch", "torque_ripple"}
    (ripple,) = (item for item in found.effects if item.effect == "torque_ripple")
    assert ripple.parameters["order"].value == 5.0
    assert value(found, "viscous_friction") == pytest.approx(Rig().viscous_Nm_s, rel=0.1)
    assert value(found, "inertia_mismatch") == pytest.approx(0.25, abs=0.01)


def test_friction_that_grows_with_the_square_is_not_named_where_none_that_grows_with_the_speed_could_be() -> None:
    (recording,) = Rig(swing=(3.0, 2.0), about_rad_s=25.0).recordings(1, seed=1)
    found = names(diagnose(recording, axis_model(1.6e-4), "blind"))
    assert found <= {"coulomb_friction", "inertia_mismatch", "torque_ripple"}  # the rig has one of order 5


@pytest.mark.parametrize(("swing_Hz", "swing_rad_s"), [(7.0, 10.0), *slow((7.0, 15.0), (10.0, 8.0))])
def test_on_one_fast_sine_friction_that_turns_over_a_way_is_no_torque_that_is_late(
    swing_Hz: float, swing_rad_s: float
) -> None:
    (recording,) = Rig(swing=(swing_Hz, swing_rad_s)).recordings(1, seed=1)
    found = diagnose(recording, axis_model(1.6e-4), "blind")
    assert {"coulomb_friction", "inertia_mismatch"} <= names(found)
    assert not {"torque_delay", "backlash", "unbalance"} & names(found)
    assert value(found, "coulomb_friction") == pytest.approx(Rig().coulomb_Nm, rel=0.15)
    assert value(found, "inertia_mismatch") == pytest.approx(0.25, abs=0.025)
    (presliding,) = (item for item in found.nuisance if item.effect == "presliding")
    assert presliding.parameters["way_m"].value == pytest.approx(Rig().coulomb_Nm / 40.0, rel=0.35)
