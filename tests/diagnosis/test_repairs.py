"""Recordings as they come from a stand: rows out of order, repeated, missing, cut off; each is mended and said."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.plant.models import effect, lone_axis, model
from tests.simulated_recordings import hidden_recording

from hilbench.diagnosis.data_cleaning import mended
from hilbench.diagnosis.diagnosis import diagnose
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.predictor import choice
from hilbench.errors import UnusableInputError
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm
from hilbench.results.recording import Recording, read_recording, read_rows, write_recording

Channels = dict[str, np.ndarray]

PERIOD_S = 0.005


def moving(seed: int = 0, seconds: float = 12.0, count_m: float = 0.0, period_s: float = PERIOD_S) -> Channels:
    """A lone axis with dry friction that moves to and fro: position by an encoder of `count_m`, torque with noise."""
    t = np.arange(round(seconds / period_s)) * period_s
    x, v, a = -np.cos(1.3 * t) / 1.3, np.sin(1.3 * t), 1.3 * np.cos(1.3 * t)
    torque = np.empty(len(t))
    required_torque_Nm(lay.pack(lone_axis(effect("coulomb_friction", 1, force_N=1.5))), x, v, a, period_s, torque)
    torque += 0.02 * np.random.default_rng(seed).standard_normal(len(t))
    return {"t_s": t, "x1_m": np.round(x / count_m) * count_m if count_m else x, "v1_m_s": v, "tau1_Nm": torque}


def taken(channels: Channels) -> Measured:
    return measured_from(Recording(channels), lone_axis(), "run.csv")


def chosen(channels: Channels, rows: np.ndarray | slice) -> Channels:
    return {name: values[rows] for name, values in channels.items()}


def whats(found: Measured) -> list[str]:
    return [repair.what for repair in found.repairs]


def test_of_a_recording_with_nothing_wrong_nothing_is_said_and_every_value_stays() -> None:
    good = moving()
    found = mended(Recording(good), "run.csv")
    assert found.repairs == []
    assert found.recording.channels is not None
    assert all(np.array_equal(found.recording[name], values) for name, values in good.items())
    assert taken(good).usable(0.1).all()


@given(st.randoms(use_true_random=False), st.integers(2, 40))
@settings(max_examples=25, deadline=None)
def test_rows_in_any_order_are_the_same_recording(random: object, pieces: int) -> None:
    good = moving()
    parts = np.array_split(np.arange(len(good["t_s"])), pieces)
    random.shuffle(parts)  # type: ignore[attr-defined]
    order = np.concatenate(parts)
    found = taken(chosen(good, order))
    assert found.x_m[1] == pytest.approx(good["x1_m"], abs=0.0)
    assert found.usable().all()
    assert whats(found) == ([] if np.all(np.diff(order) > 0) else ["order"])


@given(st.sets(st.integers(0, 2399), min_size=1, max_size=200))
@settings(max_examples=25, deadline=None)
def test_rows_that_are_there_twice_count_once(again: set[int]) -> None:
    good = moving()
    rows = np.sort(np.concatenate([np.arange(2400), np.array(sorted(again))]))
    found = taken(chosen(good, rows))
    assert np.array_equal(found.tau_Nm[1], good["tau1_Nm"])
    assert whats(found) == ["repeated"]
    assert found.repairs[0].rows == len(again)


@given(st.sets(st.integers(1, 2398), min_size=1, max_size=300))
@settings(max_examples=25, deadline=None)
def test_missing_rows_are_left_out_and_all_others_stay_where_they_were(missing: set[int]) -> None:
    good = moving()
    kept = np.setdiff1d(np.arange(2400), np.array(sorted(missing)))
    found = taken(chosen(good, kept))
    assert whats(found) == ["gap"]
    assert np.array_equal(np.flatnonzero(~found.usable()), np.array(sorted(missing)))
    assert np.array_equal(found.tau_Nm[1][kept], good["tau1_Nm"][kept])
    assert found.t_s == pytest.approx(good["t_s"], abs=1e-6)


@given(st.sets(st.integers(0, 2399), min_size=1, max_size=200), st.sampled_from(["x1_m", "tau1_Nm"]))
@settings(max_examples=25, deadline=None)
def test_rows_with_a_value_that_is_no_number_are_left_out(bad: set[int], channel: str) -> None:
    good = moving()
    values = good[channel].copy()
    values[sorted(bad)] = np.nan
    found = taken({**good, channel: values})
    assert np.array_equal(np.flatnonzero(~found.usable()), np.array(sorted(bad)))
    assert (found.repairs[0].channel, found.repairs[0].rows) == (channel, len(bad))


@given(st.floats(0.05, 0.6), st.sampled_from([0.0, 1e-5]), st.floats(-3.0, 3.0))
@example(0.1923, 0.0, 0.0)  # turns round within a few rows of the wrap
@settings(max_examples=25, deadline=None)
def test_a_counter_that_wraps_is_unwrapped(range_m: float, count_m: float, start_m: float) -> None:
    good = moving(count_m=count_m)
    wrapped = np.mod(good["x1_m"] + start_m, range_m)
    found = taken({**good, "x1_m": wrapped})
    assert whats(found) == ["wrap"]
    moved = found.x_m[1] - found.x_m[1][0]
    assert moved == pytest.approx(good["x1_m"] - good["x1_m"][0], abs=2e-3 * range_m * found.repairs[0].rows)
    assert np.max(np.abs(np.diff(found.x_m[1]))) < 0.02


def test_a_torque_at_the_end_of_its_range_is_left_out_where_it_is_there_and_noise_at_its_peak_is_not() -> None:
    good = moving()
    assert taken(good).repairs == []
    cut = np.clip(good["tau1_Nm"], -4.9, 4.9)
    found = taken({**good, "tau1_Nm": cut})
    assert whats(found) == ["saturated"]
    assert np.array_equal(~found.usable(), np.abs(cut) == 4.9)
    assert "4.9 N·m" in found.repairs[0].text


def test_rows_that_repeat_the_one_before_while_the_axis_moves_are_dropped_and_standstill_is_kept() -> None:
    good = moving(count_m=1e-5)
    held = {name: values.copy() for name, values in good.items()}
    stale = np.array([301, 302, 303, 900, 1501])
    for name in ("x1_m", "v1_m_s", "tau1_Nm"):
        for k in stale:
            held[name][k] = held[name][k - 1]
    found = taken(held)
    assert np.array_equal(np.flatnonzero(~found.usable()), stale)
    stands = {**good, "tau1_Nm": np.round(good["tau1_Nm"], 1)}
    stands = {name: np.concatenate([v, np.full(400, v[-1])]) for name, v in stands.items()}
    stands["t_s"] = np.arange(2800) * PERIOD_S
    assert taken(stands).repairs == []


def test_where_only_every_second_row_is_new_its_period_is_that_of_the_new_ones() -> None:
    good = moving(period_s=0.001)
    held = {name: np.repeat(values[::2], 2) for name, values in good.items()} | {"t_s": good["t_s"]}
    found = taken(held)
    assert found.period_s == pytest.approx(0.002)
    assert found.usable().all()


@given(st.integers(0, 5))
@settings(max_examples=6, deadline=None)
def test_uneven_rows_are_put_onto_an_even_grid_by_their_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    good = moving()
    late = good["t_s"] + rng.uniform(-0.3, 0.3, 2400) * PERIOD_S
    real = {"t_s": late, "x1_m": -np.cos(1.3 * late) / 1.3, "v1_m_s": np.sin(1.3 * late), "tau1_Nm": good["tau1_Nm"]}
    found = taken(real)
    assert whats(found) == ["uneven"]
    assert found.x_m[1] == pytest.approx(-np.cos(1.3 * (found.t_s + late[0])) / 1.3, abs=2e-5)


def test_times_that_jitter_beside_an_even_motion_are_made_even() -> None:
    good = moving()
    stamped = {**good, "t_s": good["t_s"] + np.random.default_rng(0).uniform(-0.3, 0.3, 2400) * PERIOD_S}
    found = taken(stamped)
    assert np.array_equal(found.x_m[1], good["x1_m"])
    assert found.period_s == pytest.approx(PERIOD_S, rel=1e-4)


def test_too_much_that_is_wrong_is_refused_in_one_line_with_what_it_was() -> None:
    good = moving()
    with pytest.raises(UnusableInputError) as caught:
        taken(chosen(good, np.concatenate([np.arange(800), np.arange(1400, 2400)])))
    assert "25 % of the rows can't be used (600 row(s) missing in 1 place(s)" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_torque_of_a_lone_axis_that_never_changes_is_refused() -> None:
    with pytest.raises(UnusableInputError, match="channel tau1_Nm never changes, expected a measured torque"):
        taken({**moving(), "tau1_Nm": np.zeros(2400)})


def test_of_a_web_the_longest_stretch_without_a_long_gap_is_taken() -> None:
    channels = dict(hidden_recording(model(), [], duration_s=20.0).channels)
    kept = np.concatenate([np.arange(2000), np.arange(2500, 10000)])
    found = measured_from(Recording(chosen(channels, kept)), model(), "run.csv")
    assert len(found.t_s) == 7500
    assert whats(found) == ["gap", "stretch"]
    assert "t = 5 to 19.998 s" in found.repairs[1].text


def test_a_gap_is_on_no_row_that_counts_for_either_way_to_predict() -> None:
    kept = np.concatenate([np.arange(1000), np.arange(1020, 2400)])
    data = taken(chosen(moving(), kept))
    predictor = choice(lone_axis(), data).predictor
    assert not predictor.rows[(980 // predictor.every) : (1040 // predictor.every)].any()
    channels = dict(hidden_recording(model(), [], duration_s=12.0).channels)
    kept = np.concatenate([np.arange(3000), np.arange(3020, 6000)])
    web = measured_from(Recording(chosen(channels, kept)), model(), "run.csv")
    assert not choice(model(), web).predictor.rows[2900:3120].any()


@pytest.mark.slow
def test_a_recording_with_everything_wrong_gives_the_same_names_as_the_good_one() -> None:
    """Rows shuffled, repeated, missing; NaN: what is hidden is found all the same, with the repairs beside it."""
    from hilbench.plant.parameters import EffectEntry

    hidden = [EffectEntry.model_validate(effect("coulomb_friction", 2, force_N=4.2))]
    channels = {
        name: np.asarray(v, np.float64)
        for name, v in hidden_recording(model(), hidden, duration_s=30.0).channels.items()
    }
    channels["tau2_Nm"][[4000, 9000]] = np.nan
    kept = np.delete(np.arange(15000), np.r_[6000:6030, 11000])
    rows = np.concatenate([kept[5000:], kept[:5000], kept[300:320]])
    found = diagnose(Recording(chosen(channels, rows)), model(), "run.csv")
    assert {(e.effect, e.axis) for e in found.effects} == {("coulomb_friction", 2)}
    assert found.effects[0].parameters["force_N"].value == pytest.approx(4.2, rel=0.02)
    assert {repair.what for repair in found.repairs} == {"order", "repeated", "gap", "not_finite"}


def test_a_file_with_rows_out_of_order_can_be_read_to_be_mended_and_is_refused_where_it_is_not(tmp_path) -> None:  # type: ignore[no-untyped-def]
    good = moving()
    path = tmp_path / "run.csv"
    write_recording(Recording(chosen(good, np.r_[100:2400, 0:100])), path)
    assert np.array_equal(taken(dict(read_rows(path).channels)).x_m[1], good["x1_m"])
    with pytest.raises(UnusableInputError, match="strictly increasing"):
        read_recording(path)


@pytest.mark.parametrize("channel", ["x1_m", "tau1_Nm"])
def test_a_value_that_stays_while_the_axis_moves_is_left_out_and_said(channel: str) -> None:
    stuck = moving()
    values = stuck[channel].copy()
    values[700:760] = values[699]
    found = taken({**stuck, channel: values})
    assert whats(found) == ["stuck"]
    assert f"channel {channel} stays at one value in 60 row(s), the first at t = 3.5 s" in found.repairs[0].text
    assert not np.any(found.usable()[700:760])
    assert np.count_nonzero(found.usable()) == len(found.t_s) - 60
    if channel == "x1_m":
        assert np.allclose(found.x_m[1], stuck["x1_m"], atol=0.03)


def test_a_torque_that_is_often_the_same_twice_is_taken_as_it_is() -> None:
    coarse = moving()
    coarse["tau1_Nm"] = np.round(coarse["tau1_Nm"] / 0.5) * 0.5
    assert whats(taken(coarse)) == []


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_torque_without_noise_that_stays_while_friction_holds_the_axis_is_taken_as_it_is(seed: int) -> None:
    friction = [EffectEntry.model_validate(effect("coulomb_friction", 1, force_N=float(seed)))]
    still = hidden_recording(model(), friction, duration_s=20.0, seed=seed, noise=0.0)
    assert whats(measured_from(still, model(), "run.csv")) == []


def test_a_torque_without_noise_that_stays_while_a_motor_drifts_through_its_play_is_taken_as_it_is() -> None:
    play = [EffectEntry.model_validate(effect("backlash", 1, gap_rad=0.05))]
    still = hidden_recording(model(), play, duration_s=20.0, seed=21, noise=0.0)
    assert whats(measured_from(still, model(), "run.csv")) == []


def test_an_axis_at_rest_whose_counts_went_through_another_unit_is_not_taken_for_rows_that_repeat() -> None:
    rests = moving(count_m=2e-3)
    last = slice(len(rests["t_s"]) - 400, None)
    rounded = 5e-15 * (np.arange(400) // 4) + np.where(np.arange(400) < 8, 1e-15 * np.arange(400), 0.0)
    rests["x1_m"][last] = rests["x1_m"][last.start - 1] + rounded
    rests["tau1_Nm"][last] = rests["tau1_Nm"][last.start - 1]
    rests["v1_m_s"][last] = 0.0
    assert whats(taken(rests)) == []
