"""Metrics on signals whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench.runs import figures
from hilbench.runs.events import Changed, Event
from hilbench.runs.metrics import Metrics, all_metrics, evaluate_metrics

E0, E1 = 8.7e9, 10.5e9
STRAIN_PREV = 80 / (E0 * 3.25e-5)
STRAIN_AFTER = 80 / (E1 * 3.25e-5)


def run(dt_s: float = 0.01, tau_s: float = 4.0) -> dict[str, NDArray[np.float64]]:
    """Ramp up in 5 s, 3 m/s to 50 s, ramp down to 55 s; E steps at 15 s, the estimate follows with `tau_s`."""
    t = np.arange(0, 55 + dt_s / 2, dt_s)
    v2 = 3 * np.clip(np.minimum(t / 5, (55 - t) / 5), 0, 1)
    true = np.where(t < 15 - 1e-9, E0, E1)
    estimate = np.where(t < 15 - 1e-9, E0, E1 - (E1 - E0) * np.exp(-(t - 15) / tau_s))
    tension = 80 + np.where(t < 15 - 1e-9, 0, 16 * np.exp(-(t - 15) / tau_s))
    return {
        "t_s": t,
        "v2_cmd_m_s": v2,
        "x1_m": 3 * t * (1 + STRAIN_PREV) / (1 + STRAIN_AFTER),
        "x2_m": 3 * t,
        "strain_prev": np.full_like(t, STRAIN_PREV),
        "strain_true": np.full_like(t, STRAIN_AFTER),
        "E_true_Pa": true,
        "E_sim_Pa": estimate,
        "F_ref_N": np.full_like(t, 80.0),
        "F_true_N": tension,
        "F_sim_N": 80 + 0.25 * np.sin(t),
    }


def test_known_answers() -> None:
    found = evaluate_metrics(run())
    assert found["E_time_to_1pct_s"] == pytest.approx(4 * np.log((E1 - E0) / E1 / 0.01), abs=0.011)
    assert found["E_final_error_pct"] == pytest.approx(
        100 * (1 - E0 / E1) * 4 / 5 * (np.exp(-7.5) - np.exp(-8.75)), 0.01
    )
    assert found["E_overshoot_pct"] == 0
    assert found["tension_recovery_s"] == pytest.approx(4 * np.log(16), abs=0.011)
    assert found["tension_rms_error_N"] == pytest.approx(16 * np.sqrt(4 / 2 / 35), rel=0.002)
    assert found["tension_peak_error_N"] == pytest.approx(16)
    assert found["tension_disturbance_pct"] == pytest.approx(20)
    assert found["tension_sim_deviation_N"] == pytest.approx(0.25, rel=1e-4)
    channels = run()
    since = channels["t_s"] >= 15 - 1e-9
    error_N = np.abs(channels["F_sim_N"] - channels["F_true_N"])[since]
    assert found["tension_sim_error_N"] == pytest.approx(error_N.max())
    assert found["v1_final_m_s"] == pytest.approx(3.000145, abs=1e-6)
    assert found["v1_expected_m_s"] == pytest.approx(3.000145, abs=1e-6)
    assert found["v1_deviation_m_s"] == pytest.approx(0, abs=1e-9)


#: What only a step of the set-point or of the line speed has.
OF_OTHER_STEPS = {"tension_overshoot_pct", "speed_settling_s", "speed_overshoot_pct"}


def test_every_metric_of_the_arrays_is_in_the_table_and_back() -> None:
    found = evaluate_metrics(run())
    assert set(found) < set(all_metrics())
    assert {name for name, value in found.items() if value is None} == OF_OTHER_STEPS


@pytest.mark.parametrize("sign", [1, -1])
def test_line_may_run_backwards_and_the_step_may_go_down(sign: int) -> None:
    channels = run()
    channels["v2_cmd_m_s"] *= sign
    channels["E_true_Pa"], channels["E_sim_Pa"] = 2 * E1 - channels["E_true_Pa"], 2 * E1 - channels["E_sim_Pa"]
    found = evaluate_metrics(channels)
    assert found["E_time_to_1pct_s"] == pytest.approx(4 * np.log((E1 - E0) / E1 / 0.01), abs=0.011)
    assert found["E_overshoot_pct"] == 0


def test_without_a_step_nothing_is_invented() -> None:
    channels = run()
    channels["E_true_Pa"][:] = E1
    found = evaluate_metrics(channels)
    assert found["E_time_to_1pct_s"] is None
    assert found["E_overshoot_pct"] is None
    assert found["tension_recovery_s"] is None
    assert found["tension_rms_error_N"] == pytest.approx(16 * np.sqrt(4 / 2 / 45), rel=0.002)  # whole window


def test_a_ramp_that_a_fault_cuts_off_leaves_the_step_before_it_judged() -> None:
    """Its last set-points came when nothing was recorded any more."""
    channels = {name: values[:5001] for name, values in run().items()}
    stopped = Event("step", 50.0, 50.03, (Changed("line_speed_m_s", 3.0, 2.98),))
    assert (
        evaluate_metrics(channels, journal=[stopped])["E_time_to_1pct_s"] == evaluate_metrics(run())["E_time_to_1pct_s"]
    )


def test_slow_drift_is_no_step() -> None:
    t = np.arange(0, 40, 0.01)
    assert figures.last_step(E0 * (1 + 0.005 * t)) is None


def test_a_short_ramp_is_one_step_for_the_overshoot() -> None:
    t = np.arange(0, 10, 0.1)
    true = np.full_like(t, E0)
    true[20:] *= 1.05
    true[60], true[61], true[62:] = E0 * 1.10, E0 * 1.15, E0 * 1.20
    assert figures.last_step(true) == 62
    estimate = true.copy()
    estimate[80] += 0.1 * 0.15 * E0  # 10 % of the second step, which is 0.15·E0 high
    assert figures.overshoot_pct(estimate, true, 62) == pytest.approx(10)


def test_staying_means_staying() -> None:
    t = np.arange(0, 20, 0.01)
    error = np.where(t < 5, 2.0, 0.5)
    assert figures.time_to_stay(t, error, 1.0, 200) == pytest.approx(3.0)
    error[1500] = -1.2
    assert figures.time_to_stay(t, error, 1.0, 200) == pytest.approx(13.01)
    error[1500] = np.nan
    assert figures.time_to_stay(t, error, 1.0, 200) == pytest.approx(13.01)
    error[-1] = 1.2
    assert figures.time_to_stay(t, error, 1.0, 200) is None
    error[-1], error[-60] = 0, 1.2
    assert figures.time_to_stay(t, error, 1.0, 200) is None  # 0.6 s in the band show nothing
    assert figures.time_to_stay(t, np.zeros_like(t), 1.0, 200) == 0.0


def test_noise_is_about_the_trend() -> None:
    t = np.arange(0, 5, 0.01)
    noise = 0.003 * E1 * np.where(np.arange(len(t)) % 2, 1.0, -1.0)
    assert figures.noise_pct(t, E1 + noise, np.full_like(t, E1)) == pytest.approx(0.3, rel=1e-3)
    assert figures.noise_pct(t, E1 * (1 + 0.01 * t) + noise, np.full_like(t, E1)) == pytest.approx(0.3, rel=1e-3)


def test_window_is_the_longest_stretch_at_working_speed() -> None:
    t = np.arange(0.0, 12.0)
    v = np.array([0, 1, 3, 3, 2, 3, 3, 3, 3.0001, 1, 3, 0])
    assert figures.working_window(t, v) == slice(5, 9)
    assert figures.working_window(t, -v) == slice(5, 9)
    assert figures.working_window(t, 0 * v) is None
    v[6] = np.nan
    assert figures.working_window(t, v) == slice(7, 9) or figures.working_window(t, v) == slice(2, 4)


def test_a_run_in_which_nothing_moved_and_nothing_stepped_has_no_metrics() -> None:
    channels = run()
    channels["v2_cmd_m_s"][:] = 0
    channels["E_true_Pa"][:] = E1
    assert set(evaluate_metrics(channels).values()) == {None}


@pytest.mark.parametrize(
    ("missing", "absent"),
    [
        (
            "E_true_Pa",
            {"E_time_to_1pct_s", "E_final_error_pct", "E_noise_pct", "E_overshoot_pct", "tension_recovery_s"},
        ),
        ("E_sim_Pa", {"E_time_to_1pct_s", "E_final_error_pct", "E_noise_pct", "E_overshoot_pct"}),
        ("F_sim_N", {"tension_sim_deviation_N", "tension_sim_error_N"}),
        ("strain_true", {"v1_final_m_s", "v1_expected_m_s", "v1_deviation_m_s"}),
    ],
)
def test_a_missing_channel_leaves_out_what_needs_it(missing: str, absent: set[str]) -> None:
    channels = run()
    del channels[missing]
    found = evaluate_metrics(channels)
    assert {name for name, value in found.items() if value is None} == absent | OF_OTHER_STEPS


def test_a_number_that_is_none_makes_no_metric() -> None:
    channels = run()
    channels["F_true_N"][3000] = np.nan
    channels["E_sim_Pa"][-600] = np.nan
    found = evaluate_metrics(channels)
    assert found["tension_rms_error_N"] is None
    assert found["E_final_error_pct"] is None
    assert found["E_overshoot_pct"] is None


def test_the_settled_part_is_the_last_seconds_without_the_transient() -> None:
    t = np.arange(0, 40, 0.01)
    slow = np.exp(-t / 4)
    assert t[figures.settled_part(t, slow)][0] == pytest.approx(35, abs=0.02)
    short = t[:300]
    quick = 20 * np.exp(-short / 0.05) + 0.01 * np.sin(60 * short)
    assert 0.2 < short[figures.settled_part(short, quick)][0] < 1.0
    assert short[figures.settled_part(short, np.exp(-short / 4))][0] == pytest.approx(1.5)  # half of it, no more


def test_velocity_from_position_resolves_a_micrometre_a_second() -> None:
    t = np.arange(0, 5, 0.002)
    x = np.round((3.000145 * t) / 1.2e-6) * 1.2e-6  # 20-bit encoder
    assert figures.mean_velocity(t, x) == pytest.approx(3.000145, abs=1e-7)


def test_a_test_that_compares_a_metric_that_is_none_says_its_reason() -> None:
    metrics = Metrics({"E_noise_pct": 0.1, "E_time_to_1pct_s": None}, {"E_time_to_1pct_s": "nothing stepped"})
    assert metrics["E_noise_pct"] < 0.2
    assert metrics.get("E_time_to_1pct_s") is None
    assert dict(metrics) == {"E_noise_pct": 0.1, "E_time_to_1pct_s": None}
    with pytest.raises(AssertionError, match="no E_time_to_1pct_s: nothing stepped"):
        assert metrics["E_time_to_1pct_s"] < 0.2
