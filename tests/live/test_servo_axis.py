"""Diagnosis of a servo axis beside its running bench: what parts and what does not, and the config that is shipped."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.bench.late_senders import late
from tests.bench.missed_cycles import missed
from tests.bench.whole_runs import Shipped

from hilbench.apps.report.html import write_report
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import EXIT_PASSED
from hilbench.live.servo_axis import LiveShaft
from hilbench.live.watch import Watch
from hilbench.live.window import Window
from hilbench.results.journal import read_journal
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.twin.virtual_io import TwinStatus

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "live_servo_friction.yaml"
LOADED = load_with_overrides(CONFIG)
MODEL, CYCLE_S, CHUNK = LOADED.config.servo_axis, LOADED.config.cycle_time_s, 250
TORQUE_NOISE_Nm, COUNT_RAD, CHUNKS = 0.05, 2.0 * np.pi / 65536, 16


def parted(seed: int = 0, *, dry_Nm: float = 0.0, inertia: float = 1.0, lost: bool = False) -> int:
    """Chunks in a row at the end that part, of a shaft that swings as its equation says, with so much dry friction more
    and so many times the inertia; `lost`: every second chunk has a cycle that nobody knows."""
    noise, watch = np.random.default_rng(seed), Watch(LiveShaft(MODEL, None, CYCLE_S), MODEL)
    shaft, swing = MODEL.shaft, np.pi
    for chunk in range(CHUNKS):
        t_s = CYCLE_S * np.arange(chunk * CHUNK, (chunk + 1) * CHUNK)
        v, a = 20.0 - 15.0 * np.cos(swing * t_s), 15.0 * swing * np.sin(swing * t_s)
        x = 20.0 * t_s - 15.0 / swing * np.sin(swing * t_s)
        friction = shaft.coulomb_friction_Nm + dry_Nm + shaft.viscous_friction_Nm_s_per_rad * v
        torque = inertia * MODEL.inertia_kg_m2 * a + friction + TORQUE_NOISE_Nm * noise.standard_normal(CHUNK)
        channels = {"x1_rad": np.round(x / COUNT_RAD) * COUNT_RAD, "v1_rad_s": v, "tau1_Nm": torque}
        known = np.ones(CHUNK, bool)
        known[CHUNK // 2] = not (lost and chunk % 2)
        watch.update((chunk + 1) * CHUNK - 1, channels, known)
    return watch.in_a_row


def test_noise_of_a_shaft_whose_model_is_right_is_no_gap() -> None:
    assert [parted(seed) for seed in range(5)] == [0] * 5
    assert parted(lost=True) == 0


def test_friction_and_inertia_that_the_model_lacks_are_one() -> None:
    assert parted(dry_Nm=0.2) == CHUNKS
    assert parted(inertia=1.1) == CHUNKS


def test_a_shaft_is_not_looked_at_behind_rows_that_came_late_while_its_load_motor_pushes_it() -> None:
    names, count, late_rows = [signal.name for signal in LOADED.config.signals], 4000, {1000: 4, 2000: 1}
    t_s, came_late = CYCLE_S * np.arange(count), np.zeros(count)
    of_signal = {"t_s": t_s, "x1_rad": 20.0 * t_s, "v1_rad_s": 20.0, "v1_cmd_rad_s": 20.0, "tau1_Nm": np.sin(t_s)}
    rows = np.column_stack([np.broadcast_to(of_signal.get(name, 0.0), count) for name in names])
    for first, length in late_rows.items():
        came_late[first : first + length] = 1.0
    window = Window(names, count, CYCLE_S)
    window.add(count - 1, np.column_stack([rows, np.arange(count), came_late]).tobytes())
    left_out = LiveShaft(MODEL, None, CYCLE_S).data_of(window, MODEL, 0, count, 0).left_out
    found = np.flatnonzero(left_out)
    assert (found[0], len(found)) == (1000, found[-1] - found[0] + 1)
    assert 0.1 < CYCLE_S * len(found) < 0.3


def run(out: Path, steps: list[dict[str, object]]) -> RunOutcome:
    """Another experiment than the shipped one, in which nothing is to be found."""
    data = LOADED.config.model_dump()
    data["steps"] = steps
    data["criteria"] = [{"name": "nothing is found", "metric": "found.count", "max": 0.0}]
    loaded = LoadedConfig(type(LOADED.config).model_validate(data), LOADED.document)
    return run_experiment(loaded, out, participants=Participants.IN_PROCESS)


@pytest.fixture(scope="module")
def friction(shipped: Shipped) -> RunOutcome:
    return shipped("live_servo_friction")


@pytest.mark.slow
def test_friction_that_comes_and_goes_is_in_the_model_and_out_of_it_again(friction: RunOutcome) -> None:
    came, went = friction.result.found or []
    assert (came.effect, came.axis, came.span, came.gone) == ("coulomb_friction", 1, None, False)
    low, high = came.parameters["torque_Nm"].ci95
    assert low < 0.3 < high
    assert came.gap is not None
    assert came.gap.before == pytest.approx(0.3, rel=0.03)
    assert abs(came.t_s - 8.5) < 1.0
    assert (went.effect, went.gone) == ("coulomb_friction", True)
    assert abs(went.t_s - 40.5) < 1.0
    told = [change.what for change in read_journal(friction.folder.journal) if change.what != "set"]
    assert [what for what in told if what == "model_applied"] == ["model_applied"] * 2


@pytest.mark.slow
def test_the_twin_has_the_model_that_was_found_and_knows_the_inertia_all_the_same(friction: RunOutcome) -> None:
    recording = read_recording(friction.folder.recording)
    has_it = (np.asarray(recording["twin_status"]).astype(int) & TwinStatus.MODEL_CHANGED) > 0
    before, during, after = np.searchsorted(recording.time_s, [8.0, 40.0, 72.0])
    assert (has_it[before], has_it[during], has_it[after]) == (False, True, False)
    for at in (before, during, after):
        assert recording["J_sim_kg_m2"][at] == pytest.approx(0.048, rel=0.01)
    # What was found is in the effect; the friction beside it is that of the model again.
    assert recording["coulomb_sim_Nm"][during] == pytest.approx(0.2, abs=0.05)


@pytest.mark.slow
def test_the_report_shows_it(friction: RunOutcome) -> None:
    page = write_report(friction.folder).read_text(encoding="utf-8")
    assert "Gap between measurement and model" in page
    assert "coulomb friction, axis 1: 0.3 N·m" in page


SWINGS = {"table": {"file": str(CONFIG.with_name("servo_axis.csv"))}}
BEGIN = {"ramp": {"path": "speed_rad_s", "to": 5.0, "duration_s": 0.5}}


@pytest.mark.slow
def test_an_unbalance_that_comes_is_in_the_model_within_a_minute(tmp_path: Path) -> None:
    comes = {"step": {"path": "load.effects.unbalance.axis1.amplitude_Nm", "to": 0.2}}
    outcome = run(tmp_path, [BEGIN, SWINGS, comes, SWINGS, SWINGS, SWINGS, SWINGS])
    (came,) = outcome.result.found or []
    low, high = came.parameters["amplitude_Nm"].ci95
    assert (came.effect, came.tied_with) == ("unbalance", [])
    assert low < 0.2 < high
    assert came.applied_after_s is not None
    assert came.applied_after_s < 60.0


@pytest.mark.slow
def test_friction_is_in_the_model_within_a_minute_beside_a_bench_that_misses_cycles(tmp_path: Path) -> None:
    comes = {"step": {"path": "load.effects.coulomb_friction.axis1.torque_Nm", "to": 0.3}}
    with missed(0.005, from_cycle=500) as left_out, late(0.018, {0x181}, from_cycle=500):
        outcome = run(tmp_path, [BEGIN, SWINGS, comes, SWINGS, SWINGS, SWINGS, SWINGS])
    assert len(left_out) > 50
    (came,) = outcome.result.found or []
    assert came.gap is not None
    assert came.gap.after < 1.4 * came.gap.noise_floor
    low, high = came.parameters["torque_Nm"].ci95
    assert came.effect == "coulomb_friction"
    assert low < 0.3 < high
    assert came.applied_after_s is not None
    assert came.applied_after_s < 60.0


@pytest.mark.slow
def test_another_inertia_is_no_change_of_the_model(tmp_path: Path) -> None:
    comes = {"step": {"path": "load.shaft.inertia_kg_m2", "to": 0.06}}
    outcome = run(tmp_path, [BEGIN, SWINGS, comes, SWINGS, SWINGS, SWINGS])
    assert outcome.exit_code == EXIT_PASSED
    said = " ".join(notice.text for notice in outcome.result.warnings or ())
    assert "model and measurement part" in said
    assert "the model stays as it is" in said
