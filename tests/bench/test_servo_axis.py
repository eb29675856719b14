"""A second kind of machine on the same bench: one shaft, whose inertia and friction a load motor emulates."""

from __future__ import annotations

import json
from collections.abc import Sequence
from math import cos, pi
from pathlib import Path
from typing import Any

import pytest
from tests.cli.in_process import hilbench

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.machines.ranges import operator_ranges
from hilbench.bench.tasks.limits import LimitTripError
from hilbench.errors import UnusableInputError, UnusableValueError
from hilbench.exchange.nodes import Nodes
from hilbench.results.recording import read_recording
from hilbench.runs.check import check_experiment
from hilbench.runs.config import ExperimentConfig, load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "servo_axis.yaml"
WEB = CONFIG.with_name("web_section_step.yaml")


def bench(*changes: str) -> Bench:
    return Bench(load_with_overrides(CONFIG, changes=changes).config, participants=Participants.IN_PROCESS)


def swing(running: Bench, duration_s: float) -> None:
    """The speed goes to and fro between 5 and 35 rad/s, twice in 2 s."""
    cycle_s = running.config.cycle_time_s
    for k in range(round(duration_s / cycle_s)):
        running.set("speed_rad_s", 20.0 - 15.0 * cos(pi * k * cycle_s))
        running.cycle()


def refused(changes: Sequence[str], match: str, config: Path = CONFIG) -> None:
    with pytest.raises(UnusableInputError, match=match):
        check_experiment(load_with_overrides(config, changes=changes))


def test_the_twin_finds_the_emulated_inertia_and_friction_and_a_step_of_it() -> None:
    with bench() as running:
        running.ramp("speed_rad_s", 5.0, duration_s=0.5)
        swing(running, 4.0)
        before = running.last
        assert before.J_true_kg_m2 == pytest.approx(0.048)
        assert before.J_sim_kg_m2 == pytest.approx(0.048, rel=0.01)
        assert before.coulomb_sim_Nm == pytest.approx(before.coulomb_true_Nm, abs=0.05)
        assert 0.0 < before.J_sd_kg_m2 < 0.01 * before.J_sim_kg_m2
        assert abs(before.coulomb_sim_Nm - before.coulomb_true_Nm) <= 1.96 * before.coulomb_sd_Nm
        viscous, deviation = before.viscous_sim_Nm_s_per_rad, before.viscous_sd_Nm_s_per_rad
        assert 0.0 < deviation < 0.004
        assert abs(viscous - 0.004) <= 1.96 * deviation
        running.step("load.shaft.inertia_kg_m2", 0.06)
        swing(running, 2.0)
        assert running.get("load.shaft.inertia_kg_m2") == running.last.J_true_kg_m2 == 0.06
        assert running.last.J_sim_kg_m2 == pytest.approx(0.06, rel=0.015)
        assert running.last.twin_status & 2  # synchronized


def test_the_drive_feels_the_flywheel_and_the_friction_that_are_not_there() -> None:
    torques = {}
    for coulomb_Nm in (0.2, 0.8):
        with bench(f"load.shaft.coulomb_friction_Nm={coulomb_Nm}") as running:
            running.ramp("speed_rad_s", 20.0, duration_s=0.5)
            running.run(0.5)
            seen = [running.cycle().tau1_Nm for _ in range(200)]
            torques[coulomb_Nm] = sum(seen) / len(seen)
            assert running.last.v1_rad_s == pytest.approx(20.0, abs=0.05)
    assert torques[0.2] == pytest.approx(0.2 + 0.004 * 20.0, abs=0.02)
    assert torques[0.8] - torques[0.2] == pytest.approx(0.6, abs=0.03)


def test_an_effect_hidden_in_the_stand_changes_what_the_drive_reports_and_not_what_is_emulated() -> None:
    with bench() as running:
        running.run(0.2)
        running.set("hardware.effects.torque_offset.axis1.offset_Nm", 0.5)
        running.ramp("speed_rad_s", 20.0, duration_s=0.5)
        running.run(0.5)
        seen = [running.cycle().tau1_Nm for _ in range(200)]
        assert sum(seen) / len(seen) == pytest.approx(0.28 + 0.5, abs=0.05)


@pytest.mark.parametrize(
    "effect",
    [
        {"effect": "inertia_mismatch", "axis": 1, "parameters": {"relative_change": 0.25}},
        {"effect": "inertia_step", "axis": 1, "parameters": {"time_s": 0.0, "relative_change": 0.25}},
    ],
    ids=lambda effect: str(effect["effect"]),
)
def test_an_inertia_that_an_effect_of_the_model_makes_larger_is_found_as_it_is(effect: dict[str, Any]) -> None:
    """What the twin finds is the whole inertia: the effect does not come on top of it."""
    data = load_with_overrides(CONFIG, changes=["load.shaft.inertia_kg_m2=0.06"]).config.model_dump()
    data["machine"]["effects"] = [effect]
    config = ExperimentConfig.model_validate(data)
    with Bench(config, participants=Participants.IN_PROCESS) as running:
        running.ramp("speed_rad_s", 5.0, duration_s=0.5)
        swing(running, 3.0)
        assert running.last.J_sim_kg_m2 == pytest.approx(0.06, rel=0.015)
        residuals = [running.cycle().tau1_residual_Nm for _ in range(200)]
        assert sum(value**2 for value in residuals) / len(residuals) < 0.08**2


def test_a_speed_beyond_its_limit_ends_the_run() -> None:
    with pytest.raises(LimitTripError, match=r"speed of axis 1 is .* rad/s"), bench() as running:
        running.ramp("speed_rad_s", 150.0, duration_s=3.0)


def test_the_twin_can_be_restarted_under_way() -> None:
    with bench() as running:
        running.ramp("speed_rad_s", 5.0, duration_s=0.5)
        swing(running, 1.0)
        running.restart_twin()
        swing(running, 3.0)
        assert running.last.J_sim_kg_m2 == pytest.approx(0.048, rel=0.015)


@pytest.mark.parametrize("path", ["line_speed_m_s", "load.web.youngs_modulus_Pa"])
def test_what_only_a_web_has_can_not_be_set_on_a_shaft(path: str) -> None:
    with bench() as running, pytest.raises(UnusableValueError, match="of another kind of machine"):
        running.set(path, 2000.0 if "Pa" in path else 1.0)


def test_an_operator_may_change_speed_inertia_and_friction_up_to_the_warnings() -> None:
    ranges = operator_ranges(load_with_overrides(CONFIG).config)
    assert list(ranges) == ["speed_rad_s", "load.shaft.inertia_kg_m2", "load.shaft.coulomb_friction_Nm"]
    assert ranges["speed_rad_s"] == (-80.0, 80.0)
    assert ranges["load.shaft.inertia_kg_m2"] == pytest.approx((0.016, 0.144))


def test_process_data_of_the_shaft_are_its_own_signals_and_nothing_is_sent_of_a_boundary() -> None:
    nodes = Nodes(load_with_overrides(CONFIG).config)
    assert [variable.subindex for variable in nodes.io.sent[0].variables] == [1, 2]
    assert nodes.io.boundary == ()
    assert len(nodes.pdo_maps("virtual_io")) == 5
    assert len(Nodes(load_with_overrides(WEB).config).io.boundary) == 1


@pytest.mark.slow
def test_the_shipped_experiment_passes_with_processes_of_its_own(tmp_path: Path) -> None:
    done = hilbench("run", CONFIG, "--bus", "embedded:test-servo-axis", "--no-report", "--out", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "inertia true / estimated" in done.stdout


@pytest.mark.slow
def test_in_real_time_the_run_comes_to_its_end_whatever_the_machine_does_beside_it(tmp_path: Path) -> None:
    """How late samples are is up to the computer; that the emulation bears it is up to the bench."""
    experiment = tmp_path / "realtime.yaml"
    experiment.write_text(
        f"include: {CONFIG}\nname: realtime\npace: realtime\n"
        "steps:\n"
        "  - ramp: {path: speed_rad_s, to: 20.0, duration_s: 0.5}\n"
        "  - step: {path: load.shaft.inertia_kg_m2, to: 0.06}\n"
        "  - ramp: {path: speed_rad_s, to: 35.0, duration_s: 0.5}\n"
        "  - ramp: {path: speed_rad_s, to: 5.0, duration_s: 1.0}\n"
        "  - ramp: {path: speed_rad_s, to: 0.0, duration_s: 0.5}\n"
        "criteria:\n  - {name: nothing is lost, metric: lost_frames, max: 0}\n"
    )
    done = hilbench("run", experiment, "--bus", "embedded:test-servo-realtime", "--no-report", "--out", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "of 2 ms, realtime" in done.stdout
    (run,) = tmp_path.glob("realtime-*")
    recording = read_recording(run / "recording.mf4")
    assert recording["t_s"][-1] == pytest.approx(2.5, abs=0.01)
    assert float(max(abs(recording["tau_load_Nm"]))) < 10.0


def test_a_command_that_knows_web_lines_only_says_so_before_it_runs_anything() -> None:
    done = hilbench("sync", CONFIG)
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        f"hilbench: {CONFIG}: the machine is a servo_axis, expected a web_line: this command knows no other"
    ]


def test_a_value_of_the_machine_that_is_wrong_is_the_one_thing_that_is_said() -> None:
    done = hilbench("check", CONFIG, "--set", "machine.drives.torque_limit_Nm=-3")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "'machine.drives.torque_limit_Nm' is -3, expected: " in line


def test_check_refuses_an_inertia_that_the_load_motor_can_not_emulate_at_the_step_that_asks_for_it() -> None:
    refused(["load.shaft.inertia_kg_m2=0.2"], r"load.shaft.inertia_kg_m2=0.2: .*can't emulate an inertia of 0.2 kg·m²")
    refused(["steps.2.step.to=0.2"], r"can't emulate an inertia of 0.2 kg·m² over a cycle of 2 ms")


def test_check_refuses_what_belongs_to_another_kind_of_machine() -> None:
    refused(["machine.kind=lathe"], "kind: web_line, servo_axis or fmu")
    refused(["machine.shaft.radius_m=1"], "unknown key 'machine.shaft.radius_m'")
    refused(["load.web.youngs_modulus_Pa=1e9"], "'shaft:' for a servo axis")
    refused(["controllers.tension_control.set_point_N=80"], "none: a servo axis follows its reference")
    refused(["steps.2.step.path=load.web.youngs_modulus_Pa", "steps.2.step.to=1e9"], "a quantity of a servo_axis")
    refused(["hardware.shaft.inertia_kg_m2=0.1"], "no 'shaft:', which is of a servo axis", WEB)
    refused(["steps.0.ramp.path=speed_rad_s"], "a quantity of a web_line", WEB)


def test_check_refuses_the_estimation_of_another_kind_of_machine() -> None:
    refused(
        ["twin.estimate=[{method: pid}]"],
        r"servo_axis.yaml:\d+.*no 'estimate:', which is of a twin of another kind of machine",
    )
    refused(["twin.torque_delay=estimate"], "no 'torque_delay:', which is of a twin of another kind of machine")
    refused(["twin.inertia.jump_pct=10"], "no 'inertia:', which is of a twin of another kind of machine", WEB)


def test_the_method_of_its_twin_can_not_be_chosen(tmp_path: Path) -> None:
    experiment = tmp_path / "chosen.yaml"
    experiment.write_text(
        f"include: {CONFIG}\nname: chosen\nsteps:\n  - hold: {{duration_s: 0.1}}\n  - synchronizer: {{method: rls}}\n"
        "criteria: []\n"
    )
    refused(
        [], r"chosen.yaml:5: a change of the twin's method, expected none: the twin of a servo_axis has one", experiment
    )
    with bench() as running, pytest.raises(UnusableValueError, match="the twin of a servo_axis has one method"):
        running.use_synchronizer("rls")


def test_check_says_how_much_inertia_is_left_and_which_ramp_is_too_steep() -> None:
    done = hilbench("check", CONFIG, "--set", "steps.0.ramp.duration_s=0.01")
    assert done.returncode == 0
    assert "times the largest inertia that is asked for" in done.stdout
    assert "expected a longer ramp" in done.stdout


@pytest.mark.slow
def test_a_run_that_was_killed_is_recovered_and_its_twin_can_be_run_again(tmp_path: Path) -> None:
    """What recovery makes of the frames alone is what a whole run records; the estimator finds the same from it."""
    experiment = tmp_path / "short.yaml"
    experiment.write_text(
        f"include: {CONFIG}\nname: short\nsteps:\n"
        "  - ramp: {path: speed_rad_s, to: 30.0, duration_s: 0.6}\n"
        "  - ramp: {path: speed_rad_s, to: 5.0, duration_s: 0.6}\n"
        "criteria: []\n"
    )
    done = hilbench("run", experiment, "--in-process", "--no-report", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (run,) = tmp_path.glob("short-*")
    whole = read_recording(run / "recording.mf4")
    (run / "recording.mf4").unlink()  # as a kill leaves it: trace and journal, and nothing that is written at the end
    (run / "result.json").unlink()
    assert hilbench("recover", run).returncode in (0, 1)
    again = read_recording(run / "recording.mf4")
    for name in ("x1_rad", "tau1_Nm", "tau_load_Nm", "J_sim_kg_m2", "J_true_kg_m2"):
        rows = min(len(again), len(whole))
        assert rows > 500
        assert again[name][:rows].tolist() == pytest.approx(whole[name][:rows].tolist(), nan_ok=True)
    replayed = hilbench("replay", run, "--twin", "--json")
    assert replayed.returncode == 0, replayed.stderr
    figures = json.loads(replayed.stdout)
    assert figures["method"] == "changepoint"
    assert figures["rms_difference_J_sim_kg_m2"] < 0.03 * 0.048
    refused_method = hilbench("replay", run, "--twin", "--method", "ekf")
    assert refused_method.returncode == 2
    assert refused_method.stderr == "hilbench: --method: 'ekf', expected changepoint: a servo axis has no other\n"
