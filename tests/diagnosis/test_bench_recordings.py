"""The bench's own recordings: a load motor emulated the web, late, and the diagnosis knows how."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.plant.models import effect, model
from tests.simulated_recordings import hidden_recording

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis.diagnosis import Diagnosis, diagnose
from hilbench.diagnosis.machines import emulation_beside, emulation_of
from hilbench.diagnosis.measured import measured_from
from hilbench.diagnosis.predictor import choice
from hilbench.plant.effects import find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation
from hilbench.plant.web_line.rig import CoupledMotor
from hilbench.results.recording import Recording, write_recording
from hilbench.results.recording_builder import Recorder
from hilbench.runs import config as config_files
from hilbench.runs.config import ExperimentConfig, load

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / "bench_configs" / "web_section_step.yaml"
E_PA = 8.7e9
Steps = list[dict[str, Any]]


def speed(to: float, duration_s: float = 1.0) -> dict[str, Any]:
    return {"ramp": {"path": "line_speed_m_s", "to": to, "duration_s": duration_s}}


def hold(duration_s: float) -> dict[str, Any]:
    return {"hold": {"duration_s": duration_s}}


def elasticity(change_pct: float) -> dict[str, Any]:
    return {"step": {"path": "load.web.youngs_modulus_Pa", "to": E_PA * (1.0 + change_pct / 100.0)}}


@cache
def demo() -> ExperimentConfig:
    return load(DEMO)[0]


def bench(steps: Steps, seed: int = 1, **changes: Any) -> tuple[ExperimentConfig, Recording]:
    """What the demonstrator's bench records of an experiment, inside this process."""
    data = {**demo().model_dump(), "seed": seed, "steps": steps, "criteria": [], **changes}
    config = ExperimentConfig.model_validate(data)
    recorder = Recorder(config.signals)
    with Bench(config, observers=[recorder], participants=Participants.IN_PROCESS) as running:
        for step in config.steps:
            step.run(running, [])
    return config, recorder.recording(datetime.now(UTC), config.description)


def diagnosed(config: ExperimentConfig, recording: Recording) -> Diagnosis:
    return diagnose(recording, config.web_line, "the bench", emulation=emulation_of(config))


def acted_s(recording: Recording) -> float:
    """When E stepped."""
    return float(recording.time_s[int(np.argmax(np.diff(recording["E_true_Pa"]) != 0.0)) + 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change_pct", "steps"),
    [
        (20.69, [speed(3.0), hold(2.0), elasticity(20.69), hold(2.5)]),
        (-2.0, [speed(-3.0), hold(2.0), elasticity(-2.0), hold(3.0)]),
        (5.0, [speed(3.0), hold(2.0), speed(2.5), elasticity(5.0), speed(1.5, 2.0), hold(1.0)]),
        (-40.0, [speed(0.5, 0.5), hold(2.0), elasticity(-40.0), hold(3.0)]),
    ],
    ids=["demo", "small-in-reverse", "in-a-ramp", "large-and-slow"],
)
def test_a_step_of_E_on_the_bench_is_named_with_time_and_size_and_nothing_else(change_pct: float, steps: Steps) -> None:
    config, recording = bench([hold(0.3), *steps])
    found = diagnosed(config, recording)
    assert [(e.effect, e.axis) for e in found.effects] == [("elasticity_step", None)]
    time_s, change = (found.effects[0].parameters[name] for name in ("time_s", "relative_change"))
    assert time_s.value == pytest.approx(acted_s(recording), abs=0.03)
    assert change.value == pytest.approx(change_pct / 100.0, abs=0.005)
    assert time_s.ci95[0] <= acted_s(recording) <= time_s.ci95[1]
    assert time_s.ci95[1] - time_s.ci95[0] >= 0.002  # no recording tells when within a cycle


@pytest.mark.slow
def test_a_ramp_of_E_is_no_ripple_and_no_step() -> None:
    ramp = {"ramp": {"path": "load.web.youngs_modulus_Pa", "to": 1.1 * E_PA, "duration_s": 2.0}}
    config, recording = bench([hold(0.3), speed(3.0), hold(1.7), ramp, hold(2.5)])
    (named,) = diagnosed(config, recording).effects
    assert named.effect == "elasticity_ramp"
    values = {name: value.value for name, value in named.parameters.items()}
    assert values["time_s"] == pytest.approx(3.0, abs=0.1)
    assert values["duration_s"] == pytest.approx(2.0, abs=0.2)
    assert values["relative_change"] == pytest.approx(0.1, abs=0.003)


@pytest.mark.slow
def test_dry_friction_that_sets_in_is_not_sold_as_a_step_of_E() -> None:
    friction = {"step": {"path": "hardware.effects.coulomb_friction.axis2.force_N", "to": 6.0}}
    config, recording = bench([hold(0.3), speed(3.0), hold(2.0), friction, hold(2.5), speed(1.0), hold(0.5)])
    found = diagnosed(config, recording)
    said = [other for named in found.effects for other in named.tied_with] + [m.condition for m in found.unexplained]
    lookalike = find_effect("elasticity_step").lookalike
    assert lookalike is not None
    assert lookalike.name in said


def test_a_bench_without_noise_is_predicted_to_the_resolution_of_its_drives() -> None:
    quiet = {"sensors": {"torque_noise_Nm": 0.0, "velocity_noise_rad_s": 0.0}}
    steps = [hold(0.3), speed(3.0), hold(1.5), elasticity(15.0), hold(2.0), speed(2.0)]
    config, recording = bench(steps, hardware={**demo().hardware.model_dump(), **quiet})
    hidden = effect("elasticity_step", time_s=acted_s(recording), relative_change=0.15)
    plant = config.web_line.with_effects(EffectEntry.model_validate(hidden))
    predictor = choice(plant, measured_from(recording, plant, "the bench"), emulation_of(config)).predictor
    left = predictor.measured - predictor.predict(lay.pack(plant)[None])[0]
    for name, residual in zip(predictor.names, left[:, predictor.rows], strict=True):
        # A unit of torque is 5 mN·m, one of position 0.24 µm; a web that is there would be off by 0.1 N·m.
        assert float(np.std(residual)) < (0.006 if name.startswith("tau") else 1e-6), name


@pytest.mark.slow
def test_a_web_that_is_there_is_not_predicted_as_an_emulated_one() -> None:
    item = EffectEntry.model_validate(effect("elasticity_step", time_s=6.1, relative_change=0.1))
    recording = hidden_recording(model(), [item], duration_s=12.0, seed=3)
    plain = diagnose(recording, model(), "a machine")
    with_bench = diagnose(recording, model(), "a machine", emulation=Emulation(0.002, (CoupledMotor(axis=2),)))
    assert plain.effects == with_bench.effects
    assert [e.effect for e in plain.effects] == ["elasticity_step"]


def test_the_run_folder_says_how_the_web_was_emulated(tmp_path: Path) -> None:
    assert emulation_beside(tmp_path / "recording.mf4") is None
    data = demo().model_dump()
    data["load_motors"]["load"]["motor"]["current_loop_time_constant_s"] = 0.002
    config_files.dump(ExperimentConfig.model_validate(data), tmp_path / "config.yaml")
    found = emulation_beside(tmp_path / "recording.mf4")
    assert found is not None
    assert found.cycle_s == 0.002
    assert found.load_motors[0].motor.current_loop_time_constant_s == 0.002
    assert found.resolution_m_s == pytest.approx((4.19e-7, 4.19e-7), rel=1e-2)


@pytest.mark.slow
def test_the_command_of_the_readme_names_the_step_of_the_demo(tmp_path: Path) -> None:
    _, recording = bench([hold(0.3), speed(3.0), hold(2.0), elasticity(20.69), hold(2.5)])
    write_recording(recording, tmp_path / "recording.csv.gz")
    done = hilbench("diagnose", tmp_path / "recording.csv.gz", "--model", DEMO)
    assert done.returncode == 0, done.stderr
    assert "elasticity_step" in done.stdout
    assert "emulated" in done.stdout
