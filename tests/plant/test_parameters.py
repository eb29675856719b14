"""The model file: read, written, and refused with file, line and what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import write_model
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line.parameters import load_model

from .models import effect, line_of, model

FILE = """\
web:
  youngs_modulus_Pa: 8.7e9
  width_m: 0.5
  thickness_m: 65e-6
  span_length_m: 1.0
rollers:
  radius_m: 0.2
  inertia_kg_m2: 1.167
  gear_ratio: 5
motors: {inertia_kg_m2: 1e-3}
boundary: {upstream_tension_N: 80, downstream_tension_N: 70}
effects:
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "model.yaml"
    path.write_text(text)
    return path


def test_derived_quantities_are_those_of_the_design(tmp_path: Path) -> None:
    loaded = load_model(write(tmp_path, FILE + "- {effect: web_slip, axis: 2, parameters: {creep_per_N: 2.2e-6}}\n"))
    assert loaded.axis_count == 2
    assert loaded.mass_kg(1) == pytest.approx((1.167 + 25 * 0.001) / 0.04)
    assert loaded.upstream_strain == pytest.approx(0.000282935, abs=5e-10)
    assert loaded.upstream_strain * loaded.upstream_stiffness_N == pytest.approx(80.0)
    assert loaded.carries_web_load(1)
    assert loaded.effects[0].effect == "web_slip"


@pytest.mark.parametrize(
    ("line", "number", "text"),
    [
        ("- {effect: web_slap, parameters: {}}", 13, "unknown effect 'web_slap', did you mean 'web_slip'"),
        ("- {effect: web_slip, axis: 1, parameters: {creep_per_N: 1e-6}}", 13, "expected none: it is an effect of"),
        ("- {effect: coulomb_friction, parameters: {force_N: 1}}", 13, "lacks its axis"),
        ("- {effect: coulomb_friction, axis: 3, parameters: {force_N: 1}}", 12, "entry 1: .*expected 1 to 2"),
        ("- {effect: coulomb_friction, axis: 1, parameters: {force: 1}}", 13, "no parameter 'force', expected force_N"),
        ("- {effect: coulomb_friction, axis: 1}", 13, "lacks its parameter 'force_N'"),
        ("- {effect: coulomb_friction, axis: 1, parameters: {force_N: -1}}", 13, "expected 0 to"),
        ("- {effect: web_slip, parameters: {creep_per_N: .nan}}", 13, "finite"),
        ("weight: 3", 13, "not valid YAML|unknown key"),
    ],
)
def test_wrong_file_is_named_with_line(tmp_path: Path, line: str, number: int, text: str) -> None:
    with pytest.raises(UnusableInputError, match=text) as caught:
        load_model(write(tmp_path, FILE + line + "\n"))
    assert f"model.yaml:{number}:" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_counts_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    text = FILE.replace("radius_m: 0.2", "radius_m: [0.2, 0.2, 0.2]").replace("length_m: 1.0", "length_m: [1.0]")
    with pytest.raises(UnusableInputError, match="span_length_m has 1 values, expected one or 2"):
        load_model(write(tmp_path, text))


def test_written_model_reads_back_equal(tmp_path: Path) -> None:
    for original in (
        model(effect("torque_ripple", 1, amplitude_Nm=1e-5, order=2.0), effect("strain_offset", strain=-1e-5)),
        line_of(3),
    ):
        path = tmp_path / "copy.yaml"
        write_model(path, original)
        assert load_model(path) == original


def test_effects_can_be_added() -> None:
    extended = model().with_effects(EffectEntry(effect="web_damping", parameters={"time_constant_s": 0.01}))
    assert [entry.effect for entry in extended.effects] == ["web_damping"]
    with pytest.raises(ValueError, match="more than 1 times"):
        extended.with_effects(EffectEntry(effect="web_damping", parameters={"time_constant_s": 0.02}))
