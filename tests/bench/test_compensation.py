"""Compensation of eccentric rollers, torque ripple and friction on the bench: swing of the true tension, and what is
taken back."""

from __future__ import annotations

from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.control.web_line.compensation import SPEEDS, Compensated
from hilbench.errors import UnusableInputError
from hilbench.runs.config import load_with_overrides

CONFIGS = Path(__file__).parents[2] / "bench_configs"
ROLLERS, STEP, LINE = (
    CONFIGS / f"{name}.yaml" for name in ("compensated_rollers", "web_section_step", "line_two_spans")
)
OFF = "controllers.compensate=[]"
ON = "controllers.compensate=[roller_eccentricity, torque_ripple]"
TURN_S = 2.0 * pi * 0.2 / 3.0
UP_TO_SPEED_S = 4.0


def eccentric(turned_rad: float = 0.0, amplitude_m: float = 2e-5) -> str:
    """Both rollers as in the config, turned on their shafts."""
    phases = (0.5 + turned_rad, 3.6 - turned_rad)  # by half a turn it is the same which way
    rollers = (
        f"{{effect: roller_eccentricity, axis: {axis}, parameters: {{amplitude_m: {amplitude_m}, phase_rad: {phase}}}}}"
        for axis, phase in enumerate(phases, 1)
    )
    return f"[{', '.join(rollers)}]"


def at_3_m_s(
    *changes: str, duration_s: float = 16.0, config: Path = ROLLERS, then: Callable[[Bench], object] = id
) -> Bench:
    """A bench that was run at 3 m/s, and on."""
    bench = Bench(config, changes=list(changes), participants=Participants.IN_PROCESS, announce=lambda _: None)
    with bench:
        bench.ramp("line_speed_m_s", 3.0, duration_s=UP_TO_SPEED_S)
        bench.run(duration_s)
        then(bench)
    return bench


def swings_N(
    bench: Bench, since_s: float = UP_TO_SPEED_S, turn_s: float = TURN_S, signal: str = "F_true_N"
) -> NDArray[np.float64]:
    """From peak to peak of the true tension in each whole turn."""
    recording = bench.recording
    turn = ((recording.time_s - since_s) / turn_s).astype(int)
    whole = range(int((recording.time_s[-1] - since_s) / turn_s))
    return np.array([np.ptp(recording[signal][(recording.time_s >= since_s) & (turn == k)]) for k in whole])


def told(bench: Bench) -> list[tuple[float, str]]:
    """Time and text of what was noted of compensation."""
    return [(each.time_s, each.text) for each in bench.notices if each.source == "compensation"]


def test_within_twenty_turns_a_fifth_of_the_swing_is_left() -> None:
    before_N = swings_N(at_3_m_s(OFF, duration_s=9.0))
    after_N = swings_N(at_3_m_s())
    assert min(before_N) > 5.5
    assert max(after_N[20:]) < 0.1 * min(before_N)


def test_what_was_learned_holds_at_another_speed() -> None:
    def at_1_m_s(bench: Bench) -> None:
        bench.ramp("line_speed_m_s", 1.0, duration_s=2.0)
        bench.run(4.0)

    before_N, after_N = (
        swings_N(at_3_m_s(*changes, then=at_1_m_s), since_s=UP_TO_SPEED_S + 18.0, turn_s=3.0 * TURN_S)
        for changes in ([OFF], [])
    )
    assert min(before_N) > 15.0
    assert max(after_N) < 0.1 * min(before_N)


def test_what_the_model_knows_is_fed_forward_from_the_second_turn_on() -> None:
    known = f"machine.effects={eccentric()}"
    before_N, after_N = (swings_N(at_3_m_s(*changes, known, "hardware.effects=[]")) for changes in ([OFF], []))
    assert max(after_N[5:]) < 0.2 * min(before_N)


def test_what_the_model_knows_wrong_is_taken_back_within_three_turns_and_learned() -> None:
    wrong = f"machine.effects={eccentric(pi)}"
    bench = at_3_m_s(wrong, "hardware.effects=[]")
    taken_back = [at_s for at_s, text in told(bench) if "taken back" in text and "not what the model knows" in text]
    assert len(taken_back) == 1
    # Two turns are for the swing without it, one for the ramp's end.
    assert taken_back[0] < UP_TO_SPEED_S + (3 + 3) * TURN_S
    assert max(swings_N(bench)[20:]) < 0.1 * min(swings_N(at_3_m_s(OFF, wrong, "hardware.effects=[]")))


def test_a_slipped_angle_is_noticed_and_the_compensation_taken_back_within_three_turns() -> None:
    def slip(bench: Bench) -> None:
        for axis, phase_rad in ((1, 0.5 + pi), (2, 3.6 - pi)):
            bench.step(f"load.effects.roller_eccentricity.axis{axis}.phase_rad", phase_rad)
        bench.run(12.0)

    bench = at_3_m_s(then=slip)
    slipped_s = UP_TO_SPEED_S + 16.0
    taken_back = [at_s for at_s, text in told(bench) if "roller_eccentricity" in text and "makes it worse" in text]
    assert len(taken_back) == 1
    assert slipped_s < taken_back[0] < slipped_s + 3 * TURN_S
    assert max(swings_N(bench)[-6:]) < 0.2 * max(swings_N(bench, slipped_s)[:3])


def test_it_is_off_where_it_does_not_help() -> None:
    beat = "load.effects=[{effect: upstream_disturbance, parameters: {amplitude_N: 5.0, frequency_Hz: 1.9}}]"
    off, on = (at_3_m_s(each, beat, duration_s=30.0, config=STEP) for each in (OFF, ON))
    assert [text for _, text in told(on) if "taken back for good: it does not help" in text]
    assert max(swings_N(on)[-20:]) < 1.1 * max(swings_N(off)[-20:])


@pytest.mark.parametrize("duration_s", [60.0, pytest.param(600.0, marks=pytest.mark.slow)])
def test_with_a_right_model_nothing_is_done(duration_s: float) -> None:
    off, on = (at_3_m_s(each, duration_s=duration_s, config=STEP) for each in (OFF, ON))
    assert told(on) == []
    for signal in ("v1_cmd_m_s", "F_true_N", "F_sim_N"):
        np.testing.assert_array_equal(on.recording[signal], off.recording[signal])


@pytest.mark.slow
def test_it_stays_stable_for_ten_minutes() -> None:
    swing_N = swings_N(at_3_m_s(duration_s=600.0))
    assert max(swing_N[20:]) < 0.6


def test_each_span_of_a_line_is_compensated() -> None:
    eccentricities = ", ".join(
        f"{{effect: roller_eccentricity, axis: {axis}, parameters: {{amplitude_m: 2.0e-5, phase_rad: {phase}}}}}"
        for axis, phase in ((1, 0.3), (2, 2.9), (3, 5.0))
    )
    off, on = (
        at_3_m_s(
            each, f"load.effects=[{eccentricities}]", "safety.limits.speed_m_s.warning=9", duration_s=26.0, config=LINE
        )
        for each in (OFF, ON)
    )
    for signal in ("F1_true_N", "F2_true_N"):
        before_N, after_N = (swings_N(bench, 24.0, signal=signal) for bench in (off, on))
        assert max(after_N) < 0.2 * min(before_N)


def test_known_friction_is_led() -> None:
    friction = (
        "[{effect: coulomb_friction, axis: 2, parameters: {force_N: 6.0}}, "
        "{effect: viscous_friction, axis: 2, parameters: {coefficient_N_s_per_m: 4.0}}]"
    )
    known = f"machine.effects={friction}", f"hardware.effects={friction}"

    def slower(bench: Bench) -> None:
        bench.ramp("line_speed_m_s", 1.0, duration_s=1.0)
        bench.run(1.0)

    off, on = (
        at_3_m_s(each, *known, duration_s=6.0, config=STEP, then=slower)
        for each in (OFF, "controllers.compensate=[friction]")
    )
    before_N, after_N = (np.ptp(bench.recording["F_true_N"][bench.recording.time_s > 10.0]) for bench in (off, on))
    assert after_N < 0.35 * before_N


def test_a_response_that_is_the_other_way_is_given_up() -> None:
    """The loops do the opposite of what the model says: each trial is taken back within three turns."""
    same, disturbance_N = np.ones(SPEEDS, complex), 5.0 + 2.0j
    compensated = Compensated(same, same, 0.0 * same, 0.0, 100.0, 0.4)
    events, worst_N = [], 0.0
    for turn in range(60):
        left_N = disturbance_N - complex(compensated.command[0])
        worst_N = max(worst_N, abs(left_N))
        event = compensated.take(left_N, 0.0, 3.0)
        events += [(turn, event)] if event else []
    begun, ended = ([turn for turn, event in events if event == kind] for kind in ("on", "worse"))
    assert len(begun) == len(ended) == 3  # it is tried no more
    assert all(end - begin <= 3 for begin, end in zip(begun, ended, strict=True))
    assert worst_N < 2.0 * abs(disturbance_N)
    assert abs(compensated.command[0]) == 0.0


def test_no_more_is_learned_than_the_limit_lets_act() -> None:
    same, limit_m_s = np.ones(SPEEDS, complex), 1.0
    compensated = Compensated(same, same, 0.0 * same, 0.0, limit_m_s, 0.1)
    for _ in range(100):
        compensated.take(1.6 + complex(compensated.command[0]), 0.0, 3.0)
        assert abs(compensated.command[0]) <= limit_m_s
    assert compensated.is_on
    assert abs(compensated.learned) <= limit_m_s


@pytest.mark.parametrize(
    ("config", "change", "expected"),
    [
        (STEP, "controllers.compensate=[unbalance]", "roller_eccentricity"),
        (CONFIGS / "line_with_dancer.yaml", ON, "no 'compensate' on a line with 'stations:'"),
    ],
)
def test_what_can_not_be_compensated_is_refused(config: Path, change: str, expected: str) -> None:
    with pytest.raises(UnusableInputError, match=expected):
        load_with_overrides(config, changes=[change])
