"""Diagnosis of a line of several spans beside its running bench: what comes is named with its axis or span."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import Shipped

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.live.watch import Watch
from hilbench.live.web_line import LiveLine
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.runs.estimated_errors import find_metric

LOADED = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "live_line_friction.yaml")
MODEL, CYCLE_S, CHUNK = LOADED.config.web_line, LOADED.config.cycle_time_s, 250
TORQUE_NOISE_Nm, SPEED_M_S, CHUNKS = 0.05, 2.5, 40


def parting_axes(more_Nm: dict[int, float]) -> set[int]:
    """The axes whose gap is beyond four times what noise leaves at the end of a run at one speed, with so much more
    torque at some."""
    noise, watch = np.random.default_rng(0), Watch(LiveLine(MODEL, None, CYCLE_S), MODEL)
    around_N = [MODEL.boundary.upstream_tension_N] * MODEL.axis_count + [MODEL.boundary.downstream_tension_N]
    sizes: list[np.ndarray] = []
    for chunk in range(CHUNKS):
        x_m = SPEED_M_S * CYCLE_S * np.arange(chunk * CHUNK, (chunk + 1) * CHUNK)
        channels = {"strain_prev": np.full(CHUNK, MODEL.upstream_strain), "F_next_N": np.full(CHUNK, around_N[-1])}
        for axis in range(1, MODEL.axis_count + 1):
            pull_N = around_N[axis - 1] - around_N[axis] if MODEL.carries_web_load(axis) else 0.0
            torque = pull_N / MODEL.motor_rad_per_m(axis) + more_Nm.get(axis, 0.0)
            channels |= {f"x{axis}_m": x_m, f"v{axis}_m_s": np.full(CHUNK, SPEED_M_S)}
            channels[f"tau{axis}_Nm"] = torque + TORQUE_NOISE_Nm * noise.standard_normal(CHUNK)
        piece = watch.update((chunk + 1) * CHUNK - 1, channels, np.ones(CHUNK, bool))
        if piece is not None:
            sizes.append(piece.size)
    assert sizes, "the web has been exchanged"
    return {axis for axis, size in enumerate(sizes[-1], 1) if size > 4.0 * TORQUE_NOISE_Nm / np.sqrt(10.0)}


def test_the_gap_is_at_the_axis_that_has_it() -> None:
    assert parting_axes({}) == set()
    assert parting_axes({3: 0.2}) == {3}
    assert parting_axes({1: 0.2, 4: 0.2}) == {1, 4}


@pytest.mark.parametrize("later", [0, 7])
def test_a_ramp_that_begins_at_once_is_no_gap(later: int) -> None:
    gap, t_s = LiveLine(MODEL, None, CYCLE_S).gap(MODEL), CYCLE_S * np.arange(CHUNKS * CHUNK)
    begins_s, rate_m_s2 = t_s[-CHUNK // 2 + later] + 0.5 * CYCLE_S, 1.0
    ramps_s = np.maximum(t_s - begins_s, 0.0)
    x_m, v_m_s = SPEED_M_S * t_s + 0.5 * rate_m_s2 * ramps_s**2, SPEED_M_S + rate_m_s2 * ramps_s
    around_N = [MODEL.boundary.upstream_tension_N] * MODEL.axis_count + [MODEL.boundary.downstream_tension_N]
    channels = {"strain_prev": np.full(len(t_s), MODEL.upstream_strain), "F_next_N": np.full(len(t_s), around_N[-1])}
    largest_Nm = 0.0
    for axis in range(1, MODEL.axis_count + 1):
        pull_N = around_N[axis - 1] - around_N[axis] if MODEL.carries_web_load(axis) else 0.0
        inertia_N = rate_m_s2 * MODEL.mass_kg(axis) * (ramps_s > 0.0)
        channels |= {f"x{axis}_m": x_m, f"v{axis}_m_s": v_m_s}
        channels[f"tau{axis}_Nm"] = (pull_N + inertia_N) / MODEL.motor_rad_per_m(axis)
        largest_Nm = max(largest_Nm, rate_m_s2 * MODEL.mass_kg(axis) / MODEL.motor_rad_per_m(axis))
    pieces = np.split(np.arange(len(t_s)), CHUNKS)
    found = [gap.follow({name: of[rows] for name, of in channels.items()}, np.ones(CHUNK, bool)) for rows in pieces]
    assert np.all(np.isfinite(found[-1]))
    assert np.max(np.abs(found[-1])) < 0.02 * largest_Nm


def test_an_estimate_of_each_span_is_in_its_span() -> None:
    line, moduli_Pa = LiveLine(MODEL, None, CYCLE_S), np.array([8.0e9, 9.0e9, 10.0e9])
    assert line.estimated == ("E1_sim_Pa", "E2_sim_Pa", "E3_sim_Pa")
    changed = line.with_estimate(MODEL, moduli_Pa)
    assert LineFollower(changed).effective_moduli_Pa == pytest.approx(moduli_Pa)
    assert line.estimate_at(changed, 0.0) == pytest.approx(moduli_Pa)
    of_one = LiveLine(MODEL, None, CYCLE_S, [2]).with_estimate(changed, np.array([7.0e9]))
    assert LineFollower(of_one).effective_moduli_Pa == pytest.approx([8.0e9, 7.0e9, 10.0e9])


def test_what_was_found_can_be_bounded_by_its_span() -> None:
    for name in ("found.web_slip.span2.applied_after_s", "gone.web_slip.span3.t_s", "found.web_slip.creep_per_N"):
        assert find_metric(name) is not None
    assert find_metric("found.coulomb_friction.span2.t_s") is None
    assert find_metric("found.web_slip.axis4.t_s") is None


@pytest.fixture(scope="module")
def friction(shipped: Shipped) -> RunOutcome:
    return shipped("live_line_friction")


@pytest.mark.slow
def test_friction_of_an_axis_is_in_the_model_and_out_of_it_again(friction: RunOutcome) -> None:
    came, went = friction.result.found or []
    assert (came.effect, came.axis, came.span, came.gone) == ("coulomb_friction", 3, None, False)
    assert (went.effect, went.axis, went.gone) == ("coulomb_friction", 3, True)
    assert abs(came.t_s - 20.0) < 1.0
    assert abs(went.t_s - 70.0) < 1.0


@pytest.mark.slow
def test_the_twin_sees_the_true_tensions_with_it_in_the_model(friction: RunOutcome) -> None:
    recording = read_recording(friction.folder.recording)
    off_N = {
        span: np.abs(np.asarray(recording[f"F{span}_true_N"]) - np.asarray(recording[f"F{span}_sim_N"]))
        for span in (1, 2, 3)
    }
    without, with_it = ((recording.time_s > begin) & (recording.time_s < begin + 3.0) for begin in (40.0, 60.0))
    assert max(each[without].mean() for each in off_N.values()) > 3.0
    assert max(each[with_it].mean() for each in off_N.values()) < 0.5


@pytest.mark.slow
def test_the_report_shows_the_gap_of_that_axis(friction: RunOutcome) -> None:
    page = write_report(friction.folder).read_text(encoding="utf-8")
    assert "coulomb friction, axis 3" in page
    assert "Could also be" in page
    history = friction.result.gap_history
    assert history is not None
    assert history.signal == "tau3_Nm"
    assert max(gap for gap in history.in_use if gap) > 0.15


@pytest.mark.slow
def test_creep_between_two_spans_is_named_with_its_span_and_in_the_model(tmp_path: Path) -> None:
    data = LOADED.config.model_dump()
    data["steps"] = [
        {"ramp": {"path": "line_speed_m_s", "to": 2.5, "duration_s": 3.0}},
        {"hold": {"until_s": 20.0}},
        {"step": {"path": "load.effects.web_slip.span2.creep_per_N", "to": 4.0e-6}},
        {"hold": {"duration_s": 4.0}},
        {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 1.0}},
        {"hold": {"duration_s": 4.0}},
        {"set": {"path": "tension_control.span2.set_point_N", "to": 95.0}},
        {"hold": {"until_s": 64.0}},
    ]
    data["criteria"] = []
    changed = LoadedConfig(type(LOADED.config).model_validate(data), LOADED.document)
    outcome = run_experiment(changed, tmp_path, participants=Participants.IN_PROCESS)
    (came,) = outcome.result.found or []
    assert (came.effect, came.axis, came.span) == ("web_slip", None, 2)
    assert came.parameters["creep_per_N"].value == pytest.approx(4.0e-6, rel=0.05)
    assert came.applied_after_s is not None
    assert came.gap is not None
    assert came.gap.before > 5.0 * came.gap.noise_floor
    assert came.gap.after < 1.1 * came.gap.noise_floor
    recording = read_recording(outcome.folder.recording)
    last = recording.time_s > recording.time_s[-1] - 3.0
    for span in (1, 2, 3):
        off_N = np.asarray(recording[f"F{span}_true_N"]) - np.asarray(recording[f"F{span}_sim_N"])
        assert np.abs(off_N[last]).mean() < 0.5
