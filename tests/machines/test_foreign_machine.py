"""A machine of another package: checked, run, reported, shown and diagnosed by its entry point alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from tests.bench.whole_runs import ROOT
from tests.pages.page_server import Server
from tests.pages.test_bounds import Site

from hilbench.results.recording import read_recording

PACKAGE = Path(__file__).parent / "fan"
_CONFIG = f"""
include: {ROOT}/bench_configs/servo_axis.yaml
name: fan
machine: {{kind: fan, drag_Nm_s2_per_rad2: 0.0005}}
steps:
  - ramp: {{path: speed_rad_s, to: 5.0, duration_s: 0.5}}
  - table: {{file: {ROOT}/bench_configs/servo_axis.csv}}
  - step: {{path: load.fan.drag_Nm_s2_per_rad2, to: 0.0006}}
  - hold: {{duration_s: 1.0}}
  - ramp: {{path: speed_rad_s, to: 0.0, duration_s: 0.5}}
criteria:
  - {{name: inertia at the end, metric: J_final_error_pct, max: 2.0, unit: '%'}}
  - {{name: torque of the fan, metric: fan_torque_peak_Nm, max: 1.0, unit: 'N·m'}}
"""
#: The fan is as it is in the model, and rubs.
_RUBS = """
load: {effects: [{effect: coulomb_friction, axis: 1, parameters: {torque_Nm: 0.3}}]}
"""


def install(folder: Path, name: str, points: str) -> None:
    """Write what an installer writes of a package with these entry points."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.4\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[hilbench.machines]\n{points}\n")


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A config of the fan, whose package is on the path of what is started."""
    project = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["hilbench.machines"]
    install(tmp_path, project["name"], "\n".join(f"{kind} = {place}" for kind, place in points.items()))
    path = os.pathsep.join([str(tmp_path), str(PACKAGE), *os.environ.get("PYTHONPATH", "").split(os.pathsep)])
    monkeypatch.setenv("PYTHONPATH", path.rstrip(os.pathsep))
    (tmp_path / "fan.yaml").write_text(_CONFIG)
    return tmp_path / "fan.yaml"


def hilbench(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hilbench", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def run(config: Path, *options: str) -> Path:
    """Run a config; returns the folder of the run, which has passed."""
    done = hilbench("run", config, "--out", config.parent / "runs", *options)
    assert done.returncode == 0, done.stderr + done.stdout
    (folder,) = (config.parent / "runs").glob("*/")
    return folder


def test_a_machine_of_another_package_runs_and_is_reported_with_its_signals(bench: Path) -> None:
    folder = run(bench, "--in-process")
    recording = read_recording(folder / "recording.mf4")
    speed, drag = recording["v1_rad_s"], recording["drag_true_Nm_s2_per_rad2"]
    assert {round(value, 6) for value in drag.tolist()} >= {0.0005, 0.0006}
    last = slice(-600, -300)  # at a steady speed
    assert recording["tau_fan_true_Nm"][last] == pytest.approx(0.0006 * speed[last] ** 2, abs=2e-3)
    assert recording["tau1_residual_Nm"][speed > 25.0].mean() == pytest.approx(0.0, abs=0.05)  # the twin's fan drags
    assert "Torque of the fan" in (folder / "report.html").read_text()


@pytest.mark.slow
def test_it_runs_in_processes_of_its_own(bench: Path) -> None:
    assert max(read_recording(run(bench) / "recording.mf4")["tau_fan_true_Nm"]) > 0.5


@pytest.mark.slow
def test_its_page_shows_its_signals(bench: Path) -> None:
    server = Server(bench)
    with Site(server.address).viewer() as viewer:
        layout = json.loads(viewer.recv())
    server.end()
    assert "tau_fan_true_Nm" in layout["signals"]


@pytest.mark.slow
def test_friction_that_its_model_lacks_is_named(bench: Path) -> None:
    steps = _CONFIG.replace(next(line for line in _CONFIG.splitlines() if "load.fan" in line) + "\n", "")
    bench.write_text(steps + _RUBS)
    done = hilbench("diagnose", run(bench, "--in-process"), "--json")
    assert done.returncode == 0, done.stderr
    named = {(each["effect"], each["axis"]): each["parameters"] for each in json.loads(done.stdout)["effects"]}
    assert named["coulomb_friction", 1]["torque_Nm"]["value"] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("key", ["prediction", "live_diagnosis"])
def test_what_it_does_not_bring_is_said_in_a_line(bench: Path, key: str) -> None:
    found = hilbench("check", bench, "--set", f"twin.{key}={{}}")
    assert found.returncode == 2
    assert f"no '{key}:', which a machine of kind fan does not bring" in found.stderr
    assert found.stderr.count("\n") == 1


def test_an_unknown_kind_is_answered_with_those_that_there_are(bench: Path) -> None:
    found = hilbench("check", bench, "--set", "machine.kind=lathe")
    assert found.returncode == 2
    assert found.stderr.rstrip().endswith("kind: web_line, servo_axis, fmu or fan")


def test_a_package_that_cannot_be_imported_is_named_and_other_machines_run(bench: Path) -> None:
    install(bench.parent, "broken-pump", "pump = hilbench_pump:PUMP")
    found = hilbench("check", bench, "--set", "machine.kind=pump")
    assert found.returncode == 2
    assert found.stderr.count("\n") == 1
    assert "machine of kind pump: package broken-pump can't be imported" in found.stderr
    assert "No module named 'hilbench_pump'" in found.stderr
    assert hilbench("check", bench).returncode == 0


def test_hilbench_without_its_entry_points_is_to_be_installed_again(bench: Path) -> None:
    install(bench.parent, "hilbench", "")
    found = hilbench("check", bench)
    assert found.returncode == 2
    assert found.stderr.count("\n") == 1
    assert "install it again" in found.stderr
