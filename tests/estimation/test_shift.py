"""A twin holds for a shift: five minutes of each machine with everything that happens in hours, and the scores alone.

The limits are those that are wanted: a run that misses one shows a defect of the estimator.
"""

from __future__ import annotations

import numpy as np
import pytest
from tests.estimation.best_estimator import ANY, Jumps, best_deviation
from tests.estimation.shift_bench import ARRIVES_N, CONFIGS, MACHINES, Scored, run_shift
from tests.estimation.shift_offline import OfflineOutcome, ShiftCase, outcomes
from tests.estimation.shift_score import EstimateScore, TensionScore, behind, shares_of_steps
from tests.independent_line import Record, effect
from tests.independent_line.shift import TENSION_N, courses, shift_line

from hilbench.estimation.web_line.config import ModelErrorsConfig
from hilbench.results.web_line_synchronization import methods_of
from hilbench.runs.config import load_with_overrides

#: Of a right model: E and tension in motion, 1 s behind steps left out.
LARGEST_PCT, WITHIN_PCT, LARGEST_N = 3.0, 99.0, 1.0
#: Shares in which a 95 % interval of an honest estimator may hold over so short a time; and how much wider it may be
#: than that of the best estimator that allows for as much.
LEAST_HELD_PCT, MOST_HELD_PCT, WIDER = 93.0, 100.0, 1.5
MINUTES_5_S = 300.0


# -- what scores -------------------------------------------------------------------------------------------------------


def test_a_score_counts_what_is_off_and_what_an_interval_holds() -> None:
    true = np.full(4, 100.0)
    score = EstimateScore()
    counts = np.array([True, True, True, False])
    score.add(np.array([100.5, 98.0, 103.0, 500.0]), np.array([1.0, 1.0, 2.0, 1.0]), true, counts)
    assert score.cycles == 3
    assert score.worst_pct == pytest.approx(3.0)
    assert score.within_pct == pytest.approx(100.0 / 3.0)
    assert score.held_pct == pytest.approx(200.0 / 3.0)
    assert score.half_width_pct == pytest.approx(1.96, rel=0.01)
    score.add(np.array([np.nan]), np.array([np.inf]), true[:1], counts[:1])
    assert np.isinf(score.worst_pct)
    tension = TensionScore()
    tension.add(np.array([80.5, 77.0]), np.full(2, 80.0), np.array([True, True]))
    assert (tension.worst_N, tension.within_pct) == (-3.0, 50.0)


def test_what_follows_a_step_is_left_out_and_a_drift_is_none() -> None:
    values = np.concatenate([np.full(5, 1.0), np.full(10, 1.05)]) * (1.0 + 1e-5 * np.arange(15))
    steps = shares_of_steps(values)
    assert np.flatnonzero(steps).tolist() == [5]
    assert np.flatnonzero(behind(steps, 3)).tolist() == [5, 6, 7]


# -- the independent line, and the bound -------------------------------------------------------------------------------


def short_shift(**hidden: object) -> Record:
    """Twenty seconds at constant speed."""
    return shift_line(**hidden).record_courses(courses("steady", "constant", 20.0))  # type: ignore[arg-type]


def test_the_line_keeps_its_tension_by_its_own_sensor_whatever_E_is() -> None:
    asked = courses("stops", "steps", 135.0)
    record = shift_line().record_courses(asked)
    t, error = record.channels["t_s"], record.truth["F_true_N"] - asked.tension_N
    assert record.truth["E_true_Pa"][-1] / record.truth["E_true_Pa"][0] == pytest.approx(1.207)
    for from_s, to_s in ((15.0, 54.0), (60.0, 99.0), (103.0, 109.0), (116.0, 135.0)):
        assert np.abs(error[(t > from_s) & (t < to_s)]).max() < 1.0


def test_friction_that_warms_up_is_lost_in_minutes() -> None:
    line = shift_line([effect("coulomb_friction", 2, force_N=6.0)])
    record = line.record_courses(courses("steady", "constant", 300.0, warms_up=True))
    t = record.channels["t_s"]
    asked_N = [
        float(
            np.mean((25.0 * record.truth["tau2_true_Nm"] - record.truth["F_true_N"])[(t > from_s) & (t < from_s + 5.0)])
        )
        for from_s in (20.0, 290.0)
    ]
    cold_N = 6.0 * 0.5 * (np.exp(-22.5 / 300.0) - np.exp(-292.5 / 300.0))
    assert asked_N[0] - asked_N[1] == pytest.approx(cold_N, rel=0.05)


def test_of_noise_alone_the_bound_is_that_of_a_mean() -> None:
    """Cramér and Rao: the torque's noise as a force, over the tension and the root of the samples."""
    record, line = short_shift(), shift_line()
    deviation = best_deviation(record, line, ModelErrorsConfig(), Jumps((10.0,)))
    samples = 50  # 0.1 s
    at = round(10.0 / line.row_s) + samples - 1
    noise_N = line.torque_noise_Nm * line.gear_ratio / line.radius_m
    assert deviation[at] == pytest.approx(noise_N / TENSION_N / np.sqrt(samples), rel=0.02)


def constant_record(seconds: float) -> Record:
    """A line that has always run at 3 m/s and 80 N, without noise."""
    n = round(seconds / shift_line().row_s)
    t = np.arange(n) * shift_line().row_s
    truth = {
        "F_true_N": np.full(n, TENSION_N),
        "strain": np.full(n, TENSION_N / (8.7e9 * 0.5 * 65e-6)),
        "E_true_Pa": np.full(n, 8.7e9),
        "tau2_true_Nm": np.full(n, 0.4),
        **{f"x{axis}_true_m": 3.0 * t for axis in (1, 2)},
        **{f"v{axis}_true_m_s": np.full(n, 3.0) for axis in (1, 2)},
    }
    return Record({"t_s": t}, truth)


def test_at_constant_conditions_friction_stays_in_the_bound_and_another_tension_tells_it() -> None:
    """E has 20 % beforehand, friction 10 % of the tension: of their sum alone E is known to 0.2·0.1/√(0.2² + 0.1²)."""
    dry = shift_line([effect("coulomb_friction", 2, force_N=6.0)])
    steady = best_deviation(constant_record(20.0), dry, ModelErrorsConfig(), Jumps())
    assert steady[-1] == pytest.approx(0.02 / np.hypot(0.2, 0.1), rel=0.02)
    asked = courses("stops", "constant", 70.0)  # another tension at 55 s
    changing = best_deviation(dry.record_courses(asked), dry, ModelErrorsConfig(), Jumps())
    assert changing[-1] < 0.1 * steady[-1]
    anything = best_deviation(dry.record_courses(asked), dry, ModelErrorsConfig(), Jumps(), states=ANY)
    assert anything[-1] > 3.0 * changing[-1]


@pytest.mark.slow
def test_with_a_right_model_an_estimator_holds_E_where_nothing_but_it_is_judged() -> None:
    (found,) = outcomes(ShiftCase("stops", "steps"), methods_of("changepoint"), duration_s=MINUTES_5_S)
    assert abs(found.worst_pct) <= LARGEST_PCT
    assert found.within_pct >= WITHIN_PCT
    assert LEAST_HELD_PCT <= found.held_pct <= MOST_HELD_PCT


@pytest.fixture(scope="module")
def beside_friction() -> OfflineOutcome:
    """Dry friction that the model lacks."""
    return outcomes(ShiftCase("stops", "steps", "dry friction"), methods_of("changepoint"), duration_s=MINUTES_5_S)[0]


@pytest.mark.slow
def test_beside_hidden_friction_the_interval_is_honest(beside_friction: OfflineOutcome) -> None:
    assert LEAST_HELD_PCT <= beside_friction.held_pct <= MOST_HELD_PCT


@pytest.mark.slow
@pytest.mark.xfail(reason="1.7 times as wide in five minutes, with three stops; 1.5 is wanted", strict=True)
def test_beside_hidden_friction_the_interval_is_hardly_wider_than_it_must_be(beside_friction: OfflineOutcome) -> None:
    assert beside_friction.ratio <= WIDER


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["ripple", "unbalance", "unbalance, ripple"])
def test_what_turns_with_motor_or_roller_is_taken_neither_for_friction_nor_for_E(hidden: str) -> None:
    (found,) = outcomes(ShiftCase("stops", "steps", hidden), methods_of("changepoint"), duration_s=MINUTES_5_S)
    assert found.within_pct >= WITHIN_PCT
    assert found.held_pct >= LEAST_HELD_PCT


# -- benches -----------------------------------------------------------------------------------------------------------


def test_samples_count_alike_however_they_come() -> None:
    config = load_with_overrides(CONFIGS / "web_section_step.yaml").config
    n, rng = 4000, np.random.default_rng(1)
    true = np.where(np.arange(n) < 1500, 8.7e9, 9.2e9)
    rows = {
        "t_s": 0.002 * np.arange(n),
        "v2_m_s": np.where(np.arange(n) < 3000, 3.0, 0.0),
        "E_true_Pa": true,
        "E_sim_Pa": 8.7e9 * (1.0 + 0.01 * rng.standard_normal(n)),
        "E_sd_Pa": np.full(n, 1e8),
        "F_ref_N": np.where(np.arange(n) < 800, 80.0, 90.0),
        "F_true_N": np.where(np.arange(n) < 100, 70.0, 80.0) + 0.1 * rng.standard_normal(n),
        "loop_closed": np.where((np.arange(n) > 999) & (np.arange(n) < 1200), 0.0, 1.0),
    }
    whole, parts = (Scored(config, 8.0, draws=False) for _ in range(2))
    whole.take(rows)
    for begin, end in ((0, 1000), (1000, 1001), (1001, 1502), (1502, n)):
        parts.take({name: values[begin:end] for name, values in rows.items()})
    assert whole.opened == parts.opened == 1
    found, other = whole.estimates["E"], parts.estimates["E"]
    assert found.cycles == 3000 - 500  # one step, 1 s
    assert (found.cycles, found.within, found.held, found.worst) == (
        other.cycles, other.within, other.held, other.worst,
    )  # fmt: skip
    # The web has the strain upstream before; then its tension is to stay for 1 s.
    assert np.all(np.abs(rows["F_true_N"] - rows["F_ref_N"])[100:800] <= ARRIVES_N)
    assert whole.tensions["F"].cycles == parts.tensions["F"].cycles == 3000 - 2 * 500 - (100 + 500 - 1)
    assert whole.tensions["F"].worst_N == parts.tensions["F"].worst_N


@pytest.mark.slow
@pytest.mark.parametrize(
    "title",
    [
        "web_section_step",
        "web_section_step, a hold",
        "line_two_spans",
        "line_three_spans",
        "line_with_dancer",
        "winding_line",
        "servo_axis",
    ],
)
def test_a_bench_holds_its_estimates_and_tensions_and_raises_no_alarm(title: str) -> None:
    """Five minutes of process time; of the winding line a reel."""
    machine = MACHINES[title]
    found = run_shift(machine, min(MINUTES_5_S, machine.reel_s or MINUTES_5_S) / 3600.0)
    assert found.ended == ""
    assert found.notices == ()
    assert found.opened == 0
    assert found.worst_pct is not None
    assert abs(found.worst_pct) <= LARGEST_PCT
    assert found.within_pct >= WITHIN_PCT
    assert LEAST_HELD_PCT <= found.held_pct <= MOST_HELD_PCT
    assert found.tension_N is None or abs(found.tension_N) <= LARGEST_N


@pytest.mark.slow
@pytest.mark.parametrize("method", ["pid", "rls", "ekf", "input"])
def test_other_methods_hold_E_for_five_minutes(method: str) -> None:
    """The published one takes 20 s to 1 %, and the one of a black box has no E to give: their tension is judged. Those
    that solve over a window take ten times as long: `tools/shift.py --method all` has them."""
    found = run_shift(MACHINES["web_section_step, a hold"], MINUTES_5_S / 3600.0, method=method)
    assert (found.ended, found.notices, found.opened) == ("", (), 0)
    if method in ("pid", "input"):
        assert found.tension_within_pct >= 90.0
    else:
        assert found.worst_pct is not None
        assert abs(found.worst_pct) <= LARGEST_PCT
        assert found.tension_N is not None
        assert abs(found.tension_N) <= LARGEST_N


@pytest.mark.slow
@pytest.mark.parametrize("seed", [891, 1336, 2374, 5008])
def test_a_large_step_of_e_beside_an_accumulator_is_no_slip(seed: int) -> None:
    """-32, -25, -34 and +24 % at 44 s: the web and its carriage swing."""
    outcome = run_shift(MACHINES["winding_line"], 46.0 / 3600.0, seed=seed)
    assert outcome.notices == ()
    assert abs(outcome.worst_pct or 0.0) < LARGEST_PCT


@pytest.mark.slow
def test_a_small_step_of_the_inertia_as_a_ramp_begins_is_not_taken_for_friction() -> None:
    """One ramp shows inertia and friction alike: 3.4 % off where friction may change within ten minutes."""
    outcome = run_shift(MACHINES["servo_axis"], 0.5, seed=5)
    assert abs(outcome.worst_pct or 0.0) < 1.5
