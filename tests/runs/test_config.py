"""Config files: what they include, and what the command line says instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from hilbench.errors import UnusableInputError
from hilbench.plant.model_file import write_model
from hilbench.runs.config import load_with_overrides, write_config_over

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"


def test_a_config_stands_on_what_it_includes(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(f"include: {SHIPPED}\nname: mine\nmachine:\n  web:\n    width_m: 0.6\nsteps: []\n")
    config = load_with_overrides(path).config
    assert (config.name, config.web_line.required_web.width_m, config.steps) == ("mine", 0.6, [])
    assert config.web_line.required_web.thickness_m == 65e-6
    assert config.drives["axis1"].eds == SHIPPED.parents[1] / "eds" / "hilbench_servo.eds"


def test_files_that_include_each_other_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("include: b.yaml\n")
    (tmp_path / "b.yaml").write_text("name: b\ninclude: a.yaml\n")
    with pytest.raises(UnusableInputError, match=r"b.yaml:2: 'a.yaml' includes this file"):
        load_with_overrides(tmp_path / "a.yaml")


def test_the_command_line_comes_last_and_is_named() -> None:
    changes = ["load.web.youngs_modulus_Pa=9e9", "steps.1.hold.until_s=6"]
    config = load_with_overrides(SHIPPED, seed=5, changes=changes).config
    assert (config.seed, config.load.web.youngs_modulus_Pa) == (5, 9e9)
    assert config.steps[1].hold is not None
    assert config.steps[1].hold.until_s == 6
    with pytest.raises(UnusableInputError, match=r"--set machine.web.width_m=wide: 'machine.web.width_m' is 'wide'"):
        load_with_overrides(SHIPPED, changes=["machine.web.width_m=wide"])
    with pytest.raises(UnusableInputError, match=r"--set machine.colour=red: unknown key 'machine.colour'"):
        load_with_overrides(SHIPPED, changes=["machine.colour=red"])
    with pytest.raises(UnusableInputError, match="--set: 'width', expected KEY=VALUE"):
        load_with_overrides(SHIPPED, changes=["width"])


def test_an_extended_config_has_what_options_have_changed(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    changes = ["seed=7", "controllers.tension_control.bandwidth_rad_per_s=3", "criteria.0.max=0.5"]
    changes.append("machine.web.width_m=0.55")
    loaded = load_with_overrides(SHIPPED, changes=changes).config
    write_model(model, loaded.machine)
    write_config_over(tmp_path / "extended.yaml", [SHIPPED, model], changes)
    extended = load_with_overrides(tmp_path / "extended.yaml").config
    assert extended.name == "web_section_step_extended"
    assert extended.model_copy(update={"name": loaded.name, "bus": loaded.bus}) == loaded
