"""Each step is judged on its own: whichever quantity it is of, wherever the line runs, whatever comes after it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hilbench.bench.reports.change import Change
from hilbench.runs.criteria import Criterion, evaluate
from hilbench.runs.events import Event, find_events, journal_events
from hilbench.runs.metrics import Judgement, judge

Array = NDArray[np.float64]
E0, DT = 8.7e9, 0.002
LINE_SPEED, SET_POINT, MODULUS = "line_speed_m_s", "tension_control.set_point_N", "load.web.youngs_modulus_Pa"
FRICTION = "hardware.effects.coulomb_friction.axis2.force_N"


def quiet(duration_s: float, speed_m_s: float = 3.0) -> dict[str, Array]:
    """A line that runs at one speed, and nothing happens."""
    t = DT * np.arange(round(duration_s / DT) + 1)
    return {
        "t_s": t,
        "v2_cmd_m_s": np.full_like(t, speed_m_s),
        "v2_m_s": np.full_like(t, speed_m_s),
        "x1_m": speed_m_s * t,
        "x2_m": speed_m_s * t,
        "strain_prev": np.full_like(t, 3e-4),
        "strain_true": np.full_like(t, 3e-4),
        "E_true_Pa": np.full_like(t, E0),
        "E_sim_Pa": np.full_like(t, E0),
        "F_ref_N": np.full_like(t, 80.0),
        "F_true_N": np.full_like(t, 80.0),
        "F_sim_N": np.full_like(t, 80.0),
    }


def step_E(channels: dict[str, Array], at_s: float, share: float, tau_s: float) -> None:
    """E steps by a share of its value; the estimate follows with a time constant."""
    t = channels["t_s"]
    after = t >= at_s - DT / 2
    old = channels["E_true_Pa"][-1]
    channels["E_true_Pa"][after] = old * (1 + share)
    channels["E_sim_Pa"][after] = old * (1 + share * (1 - np.exp(-(t[after] - at_s) / tau_s)))
    channels["F_true_N"][after] += 16 * np.exp(-(t[after] - at_s) / tau_s)


def figures(judged: Judgement, metric: str) -> list[float | None]:
    return [figure.value for _, figure in judged.figures(metric)]


def verdict(judged: Judgement, metric: str, **bound: Any) -> Any:
    criterion = Criterion.model_validate({"name": "wanted", "metric": metric, **bound})
    return evaluate([criterion], judged.metrics(), judged)[0]


def settling_s(share: float, tau_s: float) -> float:
    return tau_s * np.log(abs(share) / (1 + share) / 0.01)


# -- every step, wherever it is --------------------------------------------------------------------------------------


def test_each_of_three_steps_has_its_own_figures_and_the_slowest_counts() -> None:
    channels = quiet(30)
    for at_s, share, tau_s in ((5, 0.1, 0.1), (12, -0.15, 0.8), (20, 0.05, 0.3)):
        step_E(channels, at_s, share, tau_s)
    judged = judge(channels)
    wanted = [settling_s(0.1, 0.1), settling_s(-0.15, 0.8), settling_s(0.05, 0.3)]
    assert figures(judged, "E_time_to_1pct_s") == pytest.approx(wanted, abs=2 * DT)
    assert judged.metrics()["E_time_to_1pct_s"] == pytest.approx(wanted[1], abs=2 * DT)
    assert [(step.number, step.start_s) for step in judged.steps] == [(1, 5.0), (2, 12.0), (3, 20.0)]
    assert verdict(judged, "E_time_to_1pct_s", max=1.0).step == 2
    assert verdict(judged, "E_time_to_1pct_s", max=1.0).verdict == "failed"
    assert verdict(judged, "E_time_to_1pct_s", max=1.0, step=1).verdict == "passed"
    assert verdict(judged, "E_time_to_1pct_s", min=0.5).step == 1  # the one that misses this bound


@pytest.mark.parametrize("place", ["slower than the fastest", "in a ramp", "at standstill", "in reverse"])
def test_a_step_is_judged_wherever_the_line_runs(place: str) -> None:
    channels = quiet(30)
    t = channels["t_s"]
    speeds = {
        "slower than the fastest": np.where(t < 15, 1.0, 3.0),
        "in a ramp": np.interp(t, [0, 5, 25, 30], [0, 0, 4, 4]),
        "at standstill": np.where(t < 15, 0.0, 3.0),
        "in reverse": np.full_like(t, -2.0),
    }
    channels["v2_cmd_m_s"] = speeds[place]
    step_E(channels, 8, 0.2, 0.1)
    judged = judge(channels)
    (at_8,) = [step for step in judged.steps if step.start_s == pytest.approx(8)]
    assert at_8.figures["E_time_to_1pct_s"].value == pytest.approx(settling_s(0.2, 0.1), abs=2 * DT)
    assert at_8.figures["tension_recovery_s"].value == pytest.approx(0.1 * np.log(16), abs=2 * DT)
    reasons = {"in a ramp": "the line speed changes", "at standstill": "the line stands still"}
    assert at_8.figures["v1_deviation_m_s"].reason == reasons.get(place, "")


def test_the_figures_of_a_step_end_where_the_next_event_begins() -> None:
    channels = quiet(30)
    step_E(channels, 5, 0.1, 0.1)
    t = channels["t_s"]
    channels["F_ref_N"][t >= 10 - DT / 2] = 95.0
    channels["F_true_N"][t >= 10 - DT / 2] += 15 * (1 - np.exp(-(t[t >= 10 - DT / 2] - 10) / 0.5))
    channels["v2_cmd_m_s"] = np.interp(t, [0, 20, 25, 30], [3, 3, 1, 1])
    judged = judge(channels)
    first, second = judged.steps
    assert (first.start_s, first.until_s) == pytest.approx((5, 10 - DT))
    assert second.until_s == pytest.approx(20, abs=2 * DT)
    assert second.figures["tension_recovery_s"].value == pytest.approx(0.5 * np.log(15), abs=2 * DT)
    assert first.figures["tension_peak_error_N"].value == pytest.approx(16)
    assert [event.kind for event in judged.events] == ["step", "step", "ramp"]
    assert str(judged.events[1]) == "set-point 80 → 95 N"


def test_a_step_of_friction_that_no_signal_shows_is_taken_from_the_journal() -> None:
    channels = quiet(20)
    t = channels["t_s"]
    after = t >= 6 - DT / 2
    channels["F_true_N"][after] += 5 * np.exp(-(t[after] - 6) / 0.4)
    assert judge(channels).steps[0].number == 0
    changes = [Change(100, "enabled"), Change(100 + 3000, "set", FRICTION, 4.2, 0.0)]
    judged = judge(channels, journal=journal_events(changes, DT))
    (step,) = judged.steps
    assert str(step.event) == "coulomb_friction.axis2.force_N 0 → 4.2"
    assert step.figures["tension_recovery_s"].value == pytest.approx(0.4 * np.log(5), abs=2 * DT)
    assert step.figures["E_time_to_1pct_s"].value == 0.0
    assert "E_overshoot_pct" not in step.figures


def test_a_quick_step_of_the_line_speed_has_settling_and_overshoot() -> None:
    channels = quiet(20, 2.0)
    t = channels["t_s"]
    after = t >= 5 - DT / 2
    channels["v2_cmd_m_s"][after] = 3.0
    since = t[after] - 5
    excess = -np.exp(-since / 0.1) * np.cos(2 * np.pi * since / 0.4)
    channels["v2_m_s"][after] = 3 + excess
    (step,) = judge(channels).steps
    assert step.figures["speed_overshoot_pct"].value == pytest.approx(100 * np.max(excess))
    assert 0.2 < (step.figures["speed_settling_s"].value or 0) < 0.45


# -- short holds, and what never comes -------------------------------------------------------------------------------


def test_a_short_hold_does_not_count_the_transient_as_noise() -> None:
    channels = quiet(6.5)
    step_E(channels, 5, 0.2, 0.04)
    noise = 1e-4 * np.random.default_rng(1).normal(size=len(channels["t_s"]))
    channels["E_sim_Pa"] *= 1 + noise
    (step,) = judge(channels).steps
    assert step.figures["E_noise_pct"].value == pytest.approx(0.01, rel=0.15)
    assert step.figures["E_final_error_pct"].value == pytest.approx(0, abs=0.01)


def test_a_hold_that_is_too_short_says_so() -> None:
    channels = quiet(12)
    step_E(channels, 5, 0.1, 0.02)
    step_E(channels, 5.4, 0.1, 0.02)
    judged = judge(channels)
    assert "hold of 0.398 s is too short" in judged.steps[0].figures["E_noise_pct"].reason
    found = verdict(judged, "E_noise_pct", max=0.1)
    assert (found.verdict, found.step) == ("passed", 2)
    assert "not judged: step 1 (E +10 % at t = 5 s): the hold" in found.reason
    assert verdict(judged, "E_noise_pct", max=0.1, step=1).verdict == "error"
    assert figures(judged, "E_time_to_1pct_s") == pytest.approx(2 * [settling_s(0.1, 0.02)], abs=2 * DT)


def test_an_estimate_that_never_gets_there_is_a_failure_and_no_error() -> None:
    channels = quiet(20)
    step_E(channels, 5, 0.2, 1e6)
    found = verdict(judge(channels), "E_time_to_1pct_s", max=25.0)
    assert (found.verdict, found.value, found.passed) == ("failed", None, False)
    assert found.reason == "step 1 (E +20 % at t = 5 s): not within 1 % for good in the hold of 15 s"


def test_a_wait_that_was_cut_short_is_a_failure_only_where_the_bound_has_passed() -> None:
    channels = quiet(12)
    step_E(channels, 5, 0.2, 1e6)
    step_E(channels, 5.5, 1 / 1.2 - 1, 0.02)
    judged = judge(channels)
    assert verdict(judged, "E_time_to_1pct_s", max=0.2, step=1).verdict == "failed"
    assert verdict(judged, "E_time_to_1pct_s", max=0.8, step=1).verdict == "error"


def test_a_step_that_the_run_does_not_have_is_an_error_that_says_so() -> None:
    channels = quiet(12)
    step_E(channels, 5, 0.2, 0.1)
    found = verdict(judge(channels), "E_noise_pct", max=1, step=3)
    assert (found.verdict, found.reason) == ("error", "the run has no E_noise_pct of step 3: it has 1 steps")
    found = verdict(judge(channels), "tension_overshoot_pct", max=1, step=1)
    assert found.reason == "step 1 (E +20 % at t = 5 s) has no tension_overshoot_pct"


def test_a_signal_that_is_not_recorded_is_named() -> None:
    channels = quiet(12)
    step_E(channels, 5, 0.2, 0.1)
    del channels["F_true_N"]
    assert judge(channels).steps[0].figures["tension_recovery_s"].reason == "F_true_N is not recorded"
    assert judge(channels).not_judged()["tension_peak_error_N"] == "F_true_N is not recorded"


def test_a_modulus_of_nothing_is_told() -> None:
    channels = quiet(12)
    channels["E_true_Pa"][channels["t_s"] >= 5] = 0.0
    (step,) = judge(channels).steps
    assert step.figures["E_time_to_1pct_s"].reason == "the true E is 0"


# -- known settling, overshoot and noise -----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    share=st.floats(0.02, 0.4),
    down=st.booleans(),
    tau_s=st.floats(0.03, 0.4),
    noise=st.floats(1e-5, 1e-3),
    hold_s=st.floats(3.0, 20.0),
    seed=st.integers(0, 2**16),
)
def test_settling_noise_and_no_overshoot_of_a_first_order_response(
    share: float, down: bool, tau_s: float, noise: float, hold_s: float, seed: int
) -> None:
    share = -share if down else share
    channels = quiet(2 + hold_s)
    step_E(channels, 2, share, tau_s)
    # One of 10 000 drawn values may well be beyond the five rms up to which an excess counts as noise.
    drawn = np.clip(np.random.default_rng(seed).normal(size=len(channels["t_s"])), -4.5, 4.5)
    channels["E_sim_Pa"] *= 1 + noise * drawn
    (step,) = judge(channels).steps
    got = {name: figure.value for name, figure in step.figures.items()}
    at_least, at_most = (max(0.0, tau_s * np.log(abs(share) / (1 + share) / (0.01 + k * noise))) for k in (6, -6))
    assert at_least - 2 * DT <= (got["E_time_to_1pct_s"] or 0) <= at_most + 2 * DT
    assert (got["E_overshoot_pct"] or 0) == 0
    over_s = tau_s * np.log(abs(share) / noise)
    if over_s < hold_s / 2 and hold_s - over_s > 1:
        assert got["E_noise_pct"] == pytest.approx(100 * noise, rel=0.2)
        assert got["E_overshoot_pct"] == 0
    else:  # not judged, or hardly touched by what is left of the transient
        assert (got["E_noise_pct"] or 0) < 100 * noise * 3


def test_an_overshoot_in_the_noise_grows_from_nothing_and_never_jumps() -> None:
    found = []
    for excess in np.linspace(0.0, 0.02, 41):
        channels = quiet(20)
        step_E(channels, 5, 0.2, 0.1)
        after = channels["t_s"] >= 5.5
        channels["E_sim_Pa"][after] += 0.2 * E0 * excess * np.exp(-(channels["t_s"][after] - 5.5) / 0.1)
        channels["E_sim_Pa"] *= 1 + 2e-4 * np.random.default_rng(1).normal(size=len(after))
        found += figures(judge(channels), "E_overshoot_pct")
    assert found[0] == 0.0
    assert 0.5 < found[-1] < 2.5
    assert np.diff(found).max() < 0.1, "0.05 % more of it are no more than that in the metric"


@settings(max_examples=60, deadline=None)
@given(
    share=st.floats(0.02, 0.4),
    overshoot=st.floats(0.05, 0.6),
    period_s=st.floats(0.05, 0.5),
    noise=st.floats(1e-6, 1e-4),
    seed=st.integers(0, 2**16),
)
def test_overshoot_of_a_second_order_response(
    share: float, overshoot: float, period_s: float, noise: float, seed: int
) -> None:
    damping = -np.log(overshoot) / np.hypot(np.pi, np.log(overshoot))
    channels = quiet(17)
    t = channels["t_s"]
    after = t >= 2 - DT / 2
    channels["E_true_Pa"][after] = E0 * (1 + share)
    natural = 2 * np.pi / period_s / np.sqrt(1 - damping**2)
    since = t[after] - 2
    swing = np.cos(2 * np.pi * since / period_s) + damping / np.sqrt(1 - damping**2) * np.sin(
        2 * np.pi * since / period_s
    )
    channels["E_sim_Pa"][after] = E0 * (1 + share * (1 - np.exp(-damping * natural * since) * swing))
    channels["E_sim_Pa"] *= 1 + noise * np.random.default_rng(seed).normal(size=len(t))
    (step,) = judge(channels).steps
    wanted = 100 * overshoot
    assert step.figures["E_overshoot_pct"].value == pytest.approx(
        wanted, rel=0.05, abs=600 * noise * (1 + share) / share
    )


# -- events ----------------------------------------------------------------------------------------------------------


def shown(events: list[Event]) -> list[tuple[str, str, float, float]]:
    return [(event.kind, str(event), round(event.start_s, 3), round(event.end_s, 3)) for event in events]


def test_a_journal_of_ramps_and_steps_becomes_a_list_of_events() -> None:
    ramp = [Change(200 + k, "set", MODULUS, E0 * (1 + k / 10_000), E0 * (1 + (k - 1) / 10_000)) for k in range(1, 1001)]
    changes = [
        Change(90, "set", LINE_SPEED, 1.0, 0.0),  # before the drives are enabled
        Change(100, "enabled"),
        *ramp,
        Change(2000, "set", SET_POINT, 90.0, 80.0),
        Change(2500, "set", SET_POINT, 90.0, 90.0),  # changes nothing
        Change(3000, "twin_lost"),
        Change(3100, "twin_back"),
        Change(4000, "stopping"),
    ]
    assert shown(journal_events(changes, DT)) == [
        ("ramp", "E +10 %", 0.202, 2.2),
        ("step", "set-point 80 → 90 N", 3.8, 3.8),
        ("mark", "twin lost", 5.8, 5.8),
        ("mark", "twin is back", 6.0, 6.0),
    ]


def test_what_journal_and_signals_both_show_is_there_once() -> None:
    channels = quiet(20)
    step_E(channels, 5, 0.1, 0.1)
    channels["F_ref_N"][channels["t_s"] >= 5 - DT / 2] = 90.0
    changes = [Change(7, "enabled"), Change(7 + 2500, "set", MODULUS, 1.1 * E0, E0)]
    found = find_events(channels, journal_events(changes, DT))
    assert shown(found) == [("step", "E +10 %, set-point 80 → 90 N", 5.0, 5.0)]


def test_a_step_in_a_ramp_of_the_same_quantity_is_seen() -> None:
    channels = quiet(20)
    t = channels["t_s"]
    channels["v2_cmd_m_s"] = np.interp(t, [0, 5, 15, 20], [1, 1, 3, 3]) + np.where(t >= 10 - DT / 2, 0.5, 0.0)
    kinds = [(event.kind, round(event.start_s, 2)) for event in find_events(channels)]
    assert ("step", 10.0) in kinds
    assert any(kind == "ramp" and at_s == pytest.approx(5, abs=0.02) for kind, at_s in kinds)
