"""Reels whose drives are told torques: what their loops do, and how a bench is set up for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tools.published_lines import torque_mode_pct

from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.tasks.web_winding_control import ReelMechanics, ReelTension, RollerMotion
from hilbench.cia402.objects import OperationMode
from hilbench.diagnosis.measured import measured_from
from hilbench.errors import UnusableInputError
from hilbench.exchange.addressing import drive_settings
from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.topology.parts import Role

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "koc_2002_torque.yaml"
SHORT = "steps=[{ramp: {path: line_speed_m_s, to: 0.5, duration_s: 0.5}}, {hold: {duration_s: 0.2}}]"


def given(folder: Path, *changes: str) -> LoadedConfig:
    return load_with_overrides(CONFIG, bus=f"embedded:{folder.name}", changes=changes)


def run(folder: Path, *changes: str) -> RunOutcome:
    return run_experiment(given(folder, *changes), folder / "run", participants=Participants.IN_PROCESS)


def test_real_and_virtual_drives_of_the_reels_are_configured_for_torques_the_others_for_speeds(tmp_path: Path) -> None:
    config = given(tmp_path).config
    for role in (Role.AXIS, Role.VIRTUAL_AXIS):
        modes = [drive_settings(config, part).mode for part in config.parts_of(role)]
        torque, velocity = OperationMode.CYCLIC_SYNCHRONOUS_TORQUE, OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
        assert modes == [torque, velocity, torque]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("controllers.winder_tension.reel=unwinder", "one controller between two driven rollers"),
        ("controllers.winder_tension.reel=coiler", "a reel in torque mode (unwinder, rewinder), 'coiler' is none"),
        ("controllers.winder_tension.load_cell=cell3", "'cell3' is none"),
        ("load.measured=[unwinder, rewinder, cell1]", "an idler with 'load: {measured: [cell2]}'"),
        (
            "load.measured=[unwinder, cell3]",
            "dancers, accumulators, reels and idlers (unwinder, rewinder, cell1, cell2)",
        ),
    ],
)
def test_what_can_t_be_a_reels_loop_is_told(tmp_path: Path, change: str, expected: str) -> None:
    with pytest.raises(UnusableInputError) as told:
        given(tmp_path, change)
    assert expected in str(told.value)


def test_nothing_is_probed_where_torques_keep_the_tensions(tmp_path: Path) -> None:
    paths = given(tmp_path).config.fast_path_places
    assert "tension_control.span1.set_point_N" in paths
    assert not any("probe" in path for path in paths)


def test_a_rollers_motion_is_that_of_its_velocity_loop(tmp_path: Path) -> None:
    """Against scipy on the loop as written, at a ramp: a drive that samples every 1 ms lags 0.5 ms, of 25, more."""
    model, cycle_s = given(tmp_path).config.web_line, 0.003
    motion, radius_m = RollerMotion(model, 2, cycle_s), 0.03
    kp, ki, mass_kg = 0.13 / radius_m**2, 2.6 / radius_m**2, model.mass_kg(2)

    def rates(t_s: float, state: np.ndarray) -> list[float]:
        speed, integral = state
        return [(kp * (t_s - speed) + ki * integral) / mass_kg, t_s - speed]

    times_s = cycle_s * np.arange(101)
    exact = solve_ivp(rates, (0.0, times_s[-1]), [0.0, 0.0], t_eval=times_s, rtol=1e-9).y[0]
    found = np.cumsum([cycle_s * motion.acceleration_m_s2(t_s + 0.5 * cycle_s) for t_s in times_s[:-1]])
    assert np.max(np.abs(found - exact[1:])) < 0.05 * np.max(np.abs(exact - times_s))


def test_a_reels_derivative_answers_to_the_tension_and_not_to_the_set_point(tmp_path: Path) -> None:
    reel = ReelMechanics.of_model(given(tmp_path).config.web_line, 3)
    loop = ReelTension(reel, 0.0, 0.0, limit_Nm=20.0, derivative_s=0.02)
    assert loop.torque_Nm(15.0, 15.0, 0.0, 0.033, 0.01) == pytest.approx(15.0 * 0.033)
    assert loop.torque_Nm(16.0, 15.0, 0.0, 0.033, 0.01) == pytest.approx(16.0 * 0.033)
    assert loop.torque_Nm(16.0, 17.0, 0.0, 0.033, 0.01) == pytest.approx((16.0 - 0.02 * 2.0 / 0.01) * 0.033)


@pytest.mark.slow
def test_tensions_are_kept_by_the_torques_of_the_reels_and_a_diagnosis_says_that_it_has_none_of_them(
    tmp_path: Path,
) -> None:
    outcome = run(tmp_path, SHORT, "criteria=[]")
    assert outcome.result.faults == []
    found = read_recording(outcome.folder.recording)
    settled = np.asarray(found["t_s"]) > 0.3
    for span, cell, axis in ((1, 1, 1), (4, 2, 3)):
        assert np.max(np.abs(np.asarray(found[f"F{span}_true_N"])[settled] - 15.0)) < 1.5
        beside = 0.5 * (np.asarray(found[f"F{2 * cell - 1}_true_N"]) + np.asarray(found[f"F{2 * cell}_true_N"]))
        np.testing.assert_allclose(found[f"F_cell{cell}_meas_N"], beside)
        # A cycle on the bus, and the encoder's torque, lie between them.
        command, torque = np.asarray(found[f"tau{axis}_cmd_Nm"]), np.asarray(found[f"tau{axis}_Nm"])
        assert np.mean(torque[settled]) == pytest.approx(np.mean(command[settled]), rel=0.05)
    assert np.asarray(found["v2_m_s"])[-1] == pytest.approx(0.5, abs=0.01)
    with pytest.raises(UnusableInputError, match="an axis in torque mode"):
        measured_from(found, given(tmp_path).config.machine, "recording")


@pytest.mark.slow
@pytest.mark.parametrize("emulated", [0.85, 1.0, 1.2])
def test_the_twin_of_reels_in_torque_mode_has_E_and_tensions_from_the_load_cells(
    tmp_path: Path, emulated: float
) -> None:
    """From rest, while the line speeds up and slows down, and as the web becomes another."""
    believed_Pa, stepped_s = 0.16e9, 2.5
    ramp = "{ramp: {path: line_speed_m_s, to: %s, duration_s: 1.0}}"
    step = f"{{step: {{path: load.web.youngs_modulus_Pa, to: {0.9 * emulated * believed_Pa}}}}}"
    steps = f"[{ramp % 1.5}, {{hold: {{until_s: {stepped_s}}}}}, {step}, {{hold: {{until_s: 3.5}}}}, {ramp % 0.8}]"
    first = f"load.web.youngs_modulus_Pa={emulated * believed_Pa}"
    outcome = run(tmp_path, f"steps={steps}", "criteria=[]", first)
    assert outcome.result.faults == []
    found = {name: np.asarray(values) for name, values in read_recording(outcome.folder.recording).channels.items()}
    time_s = found["t_s"]
    settled = (time_s > 0.5) & ~((time_s > stepped_s) & (time_s < stepped_s + 0.2))
    for span in (1, 4):
        error_Pa = found[f"E{span}_sim_Pa"] - found[f"E{span}_true_Pa"]
        assert np.max(np.abs(error_Pa / found[f"E{span}_true_Pa"])[settled]) < 0.02
        deviation_Pa = found[f"E{span}_sd_Pa"][settled]
        assert np.all(np.abs(error_Pa[settled]) < 2.0 * deviation_Pa)
        assert np.max(deviation_Pa) < 0.03 * believed_Pa
        # Idlers swing at first, and after the step, against a web that damps nothing: means over such a swing.
        cycles = 20
        off_N = np.convolve(found[f"F{span}_sim_N"] - found[f"F{span}_true_N"], np.ones(cycles) / cycles)[: len(time_s)]
        assert np.max(np.abs(off_N[settled])) < 0.02 * 15.0


@pytest.mark.slow
def test_a_twin_that_is_started_again_between_the_reels_tells_E_once_other_web_has_come(tmp_path: Path) -> None:
    ramp = "{ramp: {path: line_speed_m_s, to: 1.5, duration_s: 1.0}}"
    steps = f"steps=[{ramp}, {{hold: {{until_s: 2.0}}}}, {{restart_twin: {{}}}}, {{hold: {{duration_s: 2.5}}}}]"
    outcome = run(tmp_path, steps, "criteria=[]", "load.web.youngs_modulus_Pa=0.176e9")
    assert outcome.result.faults == []
    found = {name: np.asarray(values) for name, values in read_recording(outcome.folder.recording).channels.items()}
    again = found["t_s"] > 2.1
    for span in (1, 4):
        error = found[f"E{span}_sim_Pa"] / found[f"E{span}_true_Pa"] - 1.0
        told = again & np.isfinite(found[f"E{span}_sd_Pa"])
        # 1.9 m of web are in the line.
        assert 2.1 + 1.9 / 1.5 - 0.2 < found["t_s"][told][0] < 2.1 + 1.9 / 1.5 + 0.4
        assert np.max(np.abs(error[told])) < 0.02
        assert np.all(np.abs(error[told]) < 2.0 * found[f"E{span}_sd_Pa"][told] / 0.176e9)


@pytest.mark.slow
def test_Kocs_pid_on_the_reels_torques_deviates_as_published_within_a_third() -> None:
    unwinder, winder = torque_mode_pct(feed_forward=False)
    assert winder == pytest.approx(75.0, rel=1 / 3)
    assert unwinder == pytest.approx(60.0, rel=1 / 3)


@pytest.mark.slow
def test_with_what_the_twin_knows_Kocs_tensions_stay_within_2_percent() -> None:
    assert max(torque_mode_pct(feed_forward=True)) < 2.0
