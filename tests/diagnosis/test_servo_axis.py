"""Diagnosis of a servo axis: in rad and N·m, on its bench and on recordings of rotary machines of others."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.diagnosis.axis_rig import Rig
from tests.diagnosis.servo_bench import HIDDEN, SHIPPED, diagnosed, hiding
from tests.tiers import slow

from hilbench.diagnosis.diagnosis import Diagnosis, NamedEffect, diagnose
from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import load_machine, write_model
from hilbench.plant.servo_axis.parameters import ServoAxisParameters, ShaftParameters
from hilbench.results.recording import Recording


def only(found: Diagnosis) -> NamedEffect:
    (named,) = found.effects
    return named


@pytest.mark.parametrize(
    ("effect", "parameters"),
    [
        ("coulomb_friction", {"torque_Nm": 0.05}),
        *slow(
            ("viscous_friction", {"coefficient_Nm_s_per_rad": 0.006}),
            ("unbalance", {"amplitude_Nm": 0.1, "phase_rad": 0.5}),
            ("torque_ripple", {"amplitude_Nm": 0.1, "order": 12.0, "phase_rad": 1.0}),  # misleads the twin's estimate
            ("torque_offset", {"offset_Nm": -0.05}),
            ("inertia_mismatch", {"relative_change": 0.1}),
        ),
    ],
)
def test_an_effect_hidden_in_the_servo_bench_is_named_with_its_size_in_rad_and_Nm(
    effect: str, parameters: dict[str, float]
) -> None:
    found = diagnosed(hiding(HIDDEN, (effect, parameters)))
    assert found.verdict == "named"
    named = only(found)
    assert named.effect == effect
    # A share of the inertia is one of the model's, which is not the stand's.
    config = hiding(HIDDEN)
    shares = config.servo_rig_parameters().inertia_kg_m2 / config.servo_axis.inertia_kg_m2
    for name, value in parameters.items():
        told = named.parameters[name]
        expected = value * shares if name == "relative_change" else value
        width = max(told.ci95[1] - told.ci95[0], 0.02 * abs(expected))
        assert told.value == pytest.approx(expected, abs=width)
    assert not any("m/s" in value.unit or value.unit == "N" for value in named.parameters.values())
    assert isinstance(found.model, ServoAxisParameters)
    assert found.gap.after < min(1.05 * found.gap.noise_floor, found.gap.before)


@pytest.mark.slow
def test_the_step_of_the_shipped_experiment_is_named_beside_what_is_hidden() -> None:
    found = diagnosed(hiding(SHIPPED, ("viscous_friction", {"coefficient_Nm_s_per_rad": 0.006})))
    assert found.verdict == "named"
    assert {effect.effect for effect in found.effects} == {"inertia_step", "viscous_friction"}
    (step,) = (effect for effect in found.effects if effect.effect == "inertia_step")
    assert step.parameters["relative_change"].value == pytest.approx(0.25, abs=0.01)
    low, high = step.parameters["time_s"].ci95
    assert low <= 8.5 <= high


def test_the_extended_model_of_a_servo_axis_reads_back_as_one(tmp_path: Path) -> None:
    model = ServoAxisParameters.model_validate(
        {
            "shaft": {"inertia_kg_m2": 0.05},
            "effects": [{"effect": "coulomb_friction", "axis": 1, "parameters": {"torque_Nm": 0.3}}],
        }
    )
    write_model(tmp_path / "m.yaml", model)
    assert load_machine(tmp_path / "m.yaml") == model


@cache
def rotary() -> Recording:
    """What a rotary rig of other equations than the product's measures, under a rotary machine's names."""
    (recording,) = Rig().recordings(1)
    return Recording(
        {"t_s": recording.time_s, "x1_rad": recording["x1_m"], "tau1_Nm": recording["tau1_Nm"]},
    )


def shaft(inertia_kg_m2: float) -> ServoAxisParameters:
    return ServoAxisParameters(shaft=ShaftParameters(inertia_kg_m2=inertia_kg_m2))


@pytest.mark.slow
def test_a_recording_of_a_rotary_rig_is_diagnosed_with_a_servo_axis() -> None:
    rig = Rig()
    found = diagnose(rotary(), shaft(1.66e-4), "blind")
    assert found.verdict == "named"
    values = {effect.effect: effect.parameters for effect in found.effects}
    assert values["coulomb_friction"]["torque_Nm"].value == pytest.approx(rig.coulomb_Nm, rel=0.05)
    assert values["viscous_friction"]["coefficient_Nm_s_per_rad"].value == pytest.approx(rig.viscous_Nm_s, rel=0.08)
    assert values["torque_offset"]["offset_Nm"].value == pytest.approx(rig.offset_Nm, rel=0.1)
    assert values["torque_ripple"]["order"].value == 5.0
    assert {value.unit for each in values.values() for value in each.values()} <= {
        "N·m",
        "N·m·s/rad",
        "1",
        "1/turn",
        "rad",
    }


@pytest.mark.slow
def test_speeds_serve_where_a_rotary_recording_has_no_positions() -> None:
    whole = rotary()
    x = np.asarray(whole["x1_rad"])
    rng = np.random.default_rng(1)
    speed = np.gradient(np.convolve(x, np.ones(15) / 15.0, "same"), 0.001) + 0.02 * rng.standard_normal(len(x))
    cut = slice(20, -20)
    recording = Recording(
        {"t_s": whole.time_s[cut], "v1_rad_s": speed[cut], "tau1_Nm": np.asarray(whole["tau1_Nm"])[cut]}
    )
    found = diagnose(recording, shaft(1.66e-4), "blind")
    values = {effect.effect: effect.parameters for effect in found.effects}
    assert values["coulomb_friction"]["torque_Nm"].value == pytest.approx(Rig().coulomb_Nm, rel=0.05)
    assert values["viscous_friction"]["coefficient_Nm_s_per_rad"].value == pytest.approx(Rig().viscous_Nm_s, rel=0.1)
    assert found.missing_channels == ["x1_rad"]


def test_a_position_in_metres_is_refused_for_a_shaft() -> None:
    recording = Recording(
        {"t_s": rotary().time_s, "x1_m": rotary()["x1_rad"], "tau1_Nm": rotary()["tau1_Nm"]},
    )
    with pytest.raises(UnusableInputError, match=r"channel x1_m .* expected x1_rad or v1_rad_s"):
        diagnose(recording, shaft(1.66e-4), "blind")


@pytest.mark.slow
def test_the_command_names_what_a_servo_bench_hides_and_shows_the_gap_close(tmp_path: Path) -> None:
    done = hilbench("diagnose", HIDDEN, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "named: " in done.stdout
    assert "coulomb_friction" in done.stdout
    assert "shaft emulated by a load motor" in done.stdout
    assert "tension" not in done.stdout
    page = (tmp_path / "diagnosis.html").read_text(encoding="utf-8")
    assert "N·m" in page
    assert "the shaft was emulated by a load motor" in page
    for word in (" web ", "tension", "m/s<"):
        assert word not in page
    extended = load_machine(tmp_path / "model_extended.yaml")
    assert isinstance(extended, ServoAxisParameters)
    (entry,) = extended.effects
    assert entry.effect == "coulomb_friction"
    assert (tmp_path / "config_extended.yaml").is_file()
