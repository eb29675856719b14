"""The whole workflow on recordings in which something is hidden; it sees the recording and the plain model only."""

from __future__ import annotations

import json
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests import independent
from tests.cli.in_process import hilbench
from tests.plant.models import DEMONSTRATOR, effect, model
from tests.simulated_recordings import UNKNOWNS, hidden_recording
from tests.tiers import slow

from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis import web_line_bench_gap as bench_gap
from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.plant.effects import find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import load_model
from hilbench.results.recording import Recording, read_recording, write_recording
from hilbench.results.run import run_experiment

ROOT = Path(__file__).resolve().parents[2]
DURATION_S = 24.0


def hidden(*effects: dict[str, Any], duration_s: float = DURATION_S, **options: Any) -> Diagnosis:
    entries = [EffectEntry.model_validate(item) for item in effects]
    recording = hidden_recording(model(), entries, duration_s=duration_s, **options)
    return diagnose(recording, model(), "blind")


def places(found: Diagnosis) -> list[tuple[str, int | None]]:
    return sorted(((e.effect, e.axis) for e in found.effects), key=str)


@pytest.mark.parametrize("seed", [0, *slow(1, 2)])
def test_nothing_is_named_where_nothing_is_missing(seed: int) -> None:
    found = hidden(seed=seed)
    assert found.verdict == "complete"
    assert found.effects == []
    assert found.gap.after == found.gap.before


@pytest.mark.parametrize(
    "item",
    [
        effect("viscous_friction", 1, coefficient_N_s_per_m=1.5),
        *slow(
            effect("roller_eccentricity", 1, amplitude_m=2e-5, phase_rad=1.0),
            effect("torque_offset", 2, offset_Nm=-0.04),
            effect("inertia_mismatch", 2, relative_change=-0.1),
            effect("elasticity_drift", rate_per_s=-2e-3),
            effect("upstream_disturbance", amplitude_N=2.0, frequency_Hz=0.8, phase_rad=0.5),
            effect("elasticity_step", time_s=11.3, relative_change=0.08),
            effect("torque_ripple", 2, amplitude_Nm=0.1, order=2.0, phase_rad=-1.0),
            effect("backlash", 1, gap_rad=0.01),
            effect("unbalance", 2, amplitude_Nm=0.5, phase_rad=-1.0),
            effect("load_dependent_friction", 2, share=0.1),
            effect("quadratic_drag", 2, coefficient_N_s2_per_m2=0.5),
            effect("torque_ripple_load", 1, relative_amplitude=0.2, order=2.0, phase_rad=0.8),
            effect("feed_forward", 2, inertia_share=0.3),
            effect("encoder_error", 1, amplitude_rad=2e-3, phase_rad=1.0),
            effect("splice", time_s=11.3, relative_change=0.5, length_m=0.4),
        ),
    ],
    ids=lambda item: f"{item['effect']}-{item['axis']}",
)
def test_what_is_hidden_is_named_with_its_axis_and_values(item: dict[str, Any]) -> None:
    found = hidden(item, seed=11)
    assert found.verdict == "named"
    assert places(found) == [(item["effect"], item["axis"])]
    for name, value in item["parameters"].items():
        estimate = found.effects[0].parameters[name]
        half = 0.5 * (estimate.ci95[1] - estimate.ci95[0])
        assert abs(estimate.value - value) < 2.0 * half  # 3.9 standard errors
    for gap in found.gaps:
        assert gap.after <= 1.05 * gap.noise_floor


@pytest.mark.slow
def test_a_pair_is_told_apart_and_the_extended_model_closes_the_gap(tmp_path: Path) -> None:
    pair = effect("coulomb_friction", 2, force_N=4.0), effect("elasticity_shift", relative_change=-0.1)
    found = hidden(*pair, seed=4)
    assert places(found) == [("coulomb_friction", 2), ("elasticity_shift", None)]
    again = diagnose(
        hidden_recording(model(), [EffectEntry.model_validate(p) for p in pair], duration_s=DURATION_S, seed=5),
        found.model,
        "blind",
    )
    assert again.verdict == "complete"


@pytest.mark.slow
@pytest.mark.parametrize("name", UNKNOWNS)
def test_what_no_effect_explains_is_called_unknown(name: str) -> None:
    found = hidden(seed=2, unknown=(name, UNKNOWNS[name][1][2]), duration_s=12.0)
    assert found.verdict == "unknown"
    assert found.effects == []
    assert found.unexplained or found.gap.after > 1.05 * found.gap.noise_floor
    assert found.model.effects == ()


@pytest.mark.slow
def test_positions_that_are_not_where_a_model_has_them_are_not_called_explained_by_what_moves_no_torque() -> None:
    """Two encoders that jitter together for two seconds: as a disturbance it would be too small for the torques."""
    recording = hidden_recording(model(), [], duration_s=12.0, seed=3)
    rows = len(recording.time_s)
    jitter_m = 1e-5 * np.random.default_rng(0).standard_normal(rows)
    jitter_m[(recording.time_s <= 6.0) | (recording.time_s >= 8.0)] = 0.0
    shaken = {name: np.asarray(values) for name, values in recording.channels.items()}
    shaken |= {name: shaken[name] + jitter_m for name in ("x1_m", "x2_m")}
    found = diagnose(Recording(shaken), model(), "blind")
    assert found.verdict == "unknown"
    assert found.effects == []
    assert [one.signal for one in found.unexplained if "x1_m" in one.signal]


@pytest.mark.slow
@pytest.mark.parametrize("period_s", [0.004, 0.01, 0.02])
def test_a_coarser_recording_is_as_good(period_s: float) -> None:
    assert hidden(seed=1, period_s=period_s).verdict == "complete"
    found = hidden(effect("viscous_friction", 2, coefficient_N_s_per_m=2.0), seed=1, period_s=period_s)
    assert places(found) == [("viscous_friction", 2)]
    assert found.effects[0].parameters["coefficient_N_s_per_m"].value == pytest.approx(2.0, rel=0.05)


@pytest.mark.slow
def test_the_same_recording_gives_the_same_answer() -> None:
    one, two = (hidden(effect("torque_offset", 1, offset_Nm=0.05), seed=3) for _ in range(2))
    assert one.effects == two.effects
    assert np.array_equal(one.after, two.after)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["web_slip", "nominal", "elasticity_shift", "coulomb_friction", "roller_eccentricity", "inertia_and_step"],
)
def test_recordings_of_an_independent_simulator(name: str) -> None:
    path, labels = independent.recording(name), independent.hidden_in(name)
    found = diagnose(read_recording(path), load_model(independent.MODEL), path)
    expected = [(item.effect, None if item.effect == "web_slip" else item.axis) for item in labels]
    assert places(found) == sorted(expected, key=str)
    for item in labels:
        (named,) = [e for e in found.effects if e.effect == item.effect]
        for parameter, value in item.parameters.items():
            near = pytest.approx(value, rel=0.01, abs=2e-3 if parameter == "phase_rad" else 0.0)
            assert named.parameters[parameter].value == near, parameter


def test_a_measured_lone_axis_has_the_published_friction() -> None:
    path = independent.KEPT / "emps" / "recording.csv.gz"
    found = diagnose(read_recording(path), load_model(path.with_name("model.yaml")), path)
    named = {e.effect: e for e in found.effects}
    assert found.verdict == "named"
    # At the same speeds in both directions an offset and a friction that differs by direction are nearly one; the
    # latter leaves half as much, and beside it the offset's interval would contain zero.
    assert set(named) == {"viscous_friction", "coulomb_friction", "friction_asymmetry"}
    for item in found.effects:
        for value in (item.parameters[name] for name in find_effect(item.effect).strength):
            assert value.ci95[0] > 0.0 or value.ci95[1] < 0.0
    # Janot, Gautier, Brunot: 203.5 N·s/m and 20.39 N.
    assert named["viscous_friction"].parameters["coefficient_N_s_per_m"].value == pytest.approx(203.5, rel=0.05)
    assert named["coulomb_friction"].parameters["force_N"].value == pytest.approx(20.39, rel=0.05)
    # What is left depends on which stretches no fit has seen: 3 to 5 % of the same model's torque.
    assert found.gap.after < 0.05 * found.gap.before


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return hilbench("diagnose", *arguments)


@pytest.mark.slow
def test_the_command_prints_the_agreed_object_and_writes_page_and_model(tmp_path: Path) -> None:
    item = effect("viscous_friction", 2, coefficient_N_s_per_m=3.0)
    recording = hidden_recording(model(), [EffectEntry.model_validate(item)], duration_s=12.0)
    write_recording(recording, tmp_path / "run.csv.gz")
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(DEMONSTRATOR))
    out = tmp_path / "out"
    done = command(tmp_path / "run.csv.gz", "--model", tmp_path / "model.yaml", "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert data["verdict"] == "named"
    (named,) = data["effects"]
    assert (named["effect"], named["axis"]) == ("viscous_friction", 2)
    value = named["parameters"]["coefficient_N_s_per_m"]
    assert value["unit"] == "N·s/m"
    assert value["ci95"][0] < value["value"] < value["ci95"][1]
    assert data["gap"]["held_out"] is True
    assert data["gap"]["after"] < data["gap"]["before"]
    assert data["where"][0]["signal"] == "tau2_Nm"
    assert load_model(data["model"]).effects[0].effect == "viscous_friction"
    page = (out / "diagnosis.html").read_text()
    assert "viscous_friction" in page
    assert page.count("<svg") == 2
    assert "Residual against operating point" in page


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(("none.csv", "--model", "none.yaml"), "none.yaml"), (("none.csv",), "--model"), (("none.yaml",), "none.yaml")],
)
def test_unusable_input_is_one_line_and_exit_2(arguments: tuple[str, ...], said: str) -> None:
    done = command(*arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.slow
def test_a_bench_is_run_diagnosed_and_run_again_with_what_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_gap, "run_experiment", partial(run_experiment, participants=Participants.IN_PROCESS))
    config = tmp_path / "offset.yaml"
    steps: list[dict[str, Any]] = [{"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.5}}]
    for set_point_N in (80.0, 95.0, 70.0, 80.0):
        steps += [{"set": {"path": "tension_control.set_point_N", "to": set_point_N}}, {"hold": {"duration_s": 1.5}}]
    steps += [{"ramp": {"path": "line_speed_m_s", "to": to, "duration_s": 0.8}} for to in (1.5, 3.0, 0.5)]
    hidden_config = {"include": str(ROOT / "bench_configs" / "hidden_offset.yaml"), "steps": steps}
    config.write_text(yaml.safe_dump(hidden_config))
    done = command(config, "--out", tmp_path / "found", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert [(e["effect"], e["axis"]) for e in data["effects"]] == [("torque_offset", 2)]
    low, high = data["effects"][0]["parameters"]["offset_Nm"]["ci95"]
    assert low < 0.04 < high
    before, after = data["live"]
    assert abs(after["E_bias_pct"]) < 0.2 * abs(before["E_bias_pct"])
    assert abs(after["tension_deviation_mean_N"]) < 0.2 * abs(before["tension_deviation_mean_N"])
