"""The shipped FMU: a loose load in a carriage on a servo axis, built as docs/fmus.md says, and its bench."""

from __future__ import annotations

import subprocess
import zipfile
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench
from tests.plant.fmu.mass import needs_compiler

from hilbench.plant.fmu.config import FmuLoadConfig
from hilbench.plant.fmu.description import read_fmu
from hilbench.plant.fmu.export.archive import compiler
from hilbench.plant.fmu.model import FmuModel

pytestmark = needs_compiler
FOLDER = Path(__file__).resolve().parents[2] / "bench_configs" / "fmu"
OUTPUTS = {"angle": "rad", "rate": "rad/s", "load": "rad", "bounces": "1"}


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sliding")
    found, library = compiler(), folder / "sliding_mass.so"
    assert found is not None
    subprocess.run(
        [found, "-shared", "-fPIC", "-O2", "-Wall", "-Werror", "-o", library, FOLDER / "sliding_mass.c", "-lm"],
        check=True,
    )
    path = folder / "sliding_mass.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(FOLDER / "modelDescription.xml", "modelDescription.xml")
        archive.write(library, "binaries/linux64/sliding_mass.so")
    return path


def model(fmu: Path, **parameters: float) -> FmuModel:
    """The FMU with these values of its parameters."""
    found = read_fmu(fmu)
    block = FmuLoadConfig.model_validate({"file": fmu, "speeds": ["x"], "torques": ["x"]})
    outputs = [found.find(name, "output", unit) for name, unit in OUTPUTS.items()]
    made = FmuModel(block, [found.find("torque", "input", "N·m")], outputs, 0.001, print)
    units = {"load_inertia": "kg·m²", "load_friction": "N·m", "coulomb": "N·m", "viscous": "N·m·s/rad", "bounce": "1"}
    for name, value in parameters.items():
        made.give(found.find(name, "parameter", units[name]), value)
    made.start()
    return made


def test_impacts_are_events_within_a_step_of_any_length(fmu: Path) -> None:
    """Without friction the motion is parabolas between impacts: the length of a step changes nothing."""
    free = {"load_friction": 0.0, "coulomb": 0.0, "viscous": 0.0}
    ends = []
    for step_s in (0.001, 0.007):
        made = model(fmu, **free)
        for _ in range(round(1.4 / step_s)):
            values = made.advance([0.5], step_s)
        ends.append(values)
    assert ends[0][3] >= 2.0, "bounces"
    assert ends[1] == pytest.approx(ends[0], rel=1e-9)


def test_at_a_wall_momentum_is_kept(fmu: Path) -> None:
    """What the torque has given, carriage and load have together, however often they hit each other."""
    made = model(fmu, load_friction=0.0, coulomb=0.0, viscous=0.0, load_inertia=0.02)
    for _ in range(1000):
        angle, _, load, bounces = made.advance([0.5], 0.001)
    assert bounces >= 1.0
    centre = angle + load * 0.02 / (0.0395 + 0.02)
    assert centre == pytest.approx(0.5 * 0.5 / (0.0395 + 0.02), rel=1e-9)


def test_a_load_that_does_not_bounce_is_pushed_along(fmu: Path) -> None:
    made = model(fmu, bounce=0.0, load_friction=0.005, coulomb=0.0, viscous=0.0)
    for _ in range(1000):
        _, before, load, bounces = made.advance([0.5], 0.001)
    _, after, _, _ = made.advance([0.5], 0.001)
    assert (bounces, load) == (0.0, pytest.approx(-2.0, abs=1e-9))
    assert (after - before) / 0.001 == pytest.approx(0.5 / (0.0395 + 0.0008), rel=1e-6)


@pytest.mark.slow
def test_its_bench_passes_its_criteria(fmu: Path) -> None:
    root = FOLDER.parents[1]
    text = (FOLDER / "sliding_mass.yaml").read_text(encoding="utf-8")
    text = text.replace("../../eds", str(root / "eds")).replace(
        "../servo_axis.csv", str(FOLDER.parent / "servo_axis.csv")
    )
    config = fmu.with_name("sliding_mass.yaml")
    config.write_text(text, encoding="utf-8")
    ended = hilbench("run", config, "--in-process", "--no-report", "--out", fmu.parent / "runs")
    assert ended.returncode == 0, ended.stdout + ended.stderr
