"""A run says where it comes from, and `run --json` where it went: short runs in one process."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from tests.cli.in_process import hilbench

from hilbench.results.provenance import commit_of, overridden
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
EDS = ROOT / "eds" / "hilbench_servo.eds"
CONFIG = f"""
include: {ROOT / "bench_configs" / "web_section_step.yaml"}
name: steps
steps:
  - ramp: {{path: line_speed_m_s, to: 2.0, duration_s: 0.5}}
  - hold: {{duration_s: 1.0}}
  - step: {{path: load.web.youngs_modulus_Pa, to: 10.5e9}}
  - hold: {{duration_s: 1.5}}
  - set: {{path: tension_control.set_point_N, to: 90.0}}
  - hold: {{duration_s: 1.5}}
  - step: {{path: hardware.effects.coulomb_friction.axis2.force_N, to: 0.5}}
  - hold: {{duration_s: 0.4}}
criteria:
  - {{name: E found, metric: E_time_to_1pct_s, max: 0.2, step: 1}}
  - {{name: tension back, metric: tension_recovery_s, max: 0.01, step: 2}}
  - {{name: noise, metric: E_noise_pct, max: 0.3}}
"""


@pytest.fixture(scope="module")
def printed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("provenance")
    path = folder / "bench.yaml"
    path.write_text(CONFIG)
    done = hilbench(
        "run", path, "--in-process", "--json", "--out", folder / "runs", "--seed", "3", "--set", "description=tried"
    )
    assert done.returncode == 1, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_json_names_folder_files_exit_code_verdict_and_what_was_overridden(printed: dict[str, Any]) -> None:
    assert (printed["exit_code"], printed["verdict"], printed["passed"]) == (1, "failed", False)
    assert printed["overridden"] == {"seed": 3, "description": "tried"}
    folder = Path(printed["run"])
    names = {"config", "trace", "journal", "nodes", "recording", "result", "junit", "report"}
    assert set(printed["files"]) == names
    assert {Path(file) for file in printed["files"].values()} == set(folder.iterdir())


def test_result_and_report_say_where_the_run_comes_from(printed: dict[str, Any]) -> None:
    result = json.loads(Path(printed["files"]["result"]).read_text())
    provenance = result["provenance"]
    assert provenance["host"] == platform.node()
    assert provenance["participants"] == "in process"
    assert provenance["git"] is None  # a temporary folder is no checkout
    assert {(each["key"], each["option"]) for each in provenance["overridden"]} == {
        ("seed", "--seed"),
        ("description", "--set"),
    }
    (servo,) = (each for each in provenance["eds"] if each["file"] == str(EDS))
    assert servo["sha256"] == hashlib.sha256(EDS.read_bytes()).hexdigest()
    assert servo["nodes"] == ["axis1", "axis2", "load", "virtual_axis1", "virtual_axis2"]
    report = Path(printed["files"]["report"]).read_text()
    for wanted in (platform.node(), servo["sha256"], "description", "tried"):
        assert wanted in report


def test_each_step_of_the_run_has_its_figures(printed: dict[str, Any]) -> None:
    steps = printed["steps"]
    texts = ["E +20.7 %", "set-point 80 → 90 N", "coulomb_friction.axis2.force_N 0 → 0.5"]
    assert [step["text"] for step in steps] == texts
    assert [step["time_s"] for step in steps] == pytest.approx([1.502, 3.002, 4.502], abs=0.003)
    assert steps[0]["figures"]["E_time_to_1pct_s"] < 0.2
    assert steps[1]["figures"]["tension_recovery_s"] > 0.1
    assert "too short" in steps[2]["reasons"]["E_noise_pct"]
    assert [event["kind"] for event in printed["events"]] == ["ramp", "step", "step", "step"]
    report = Path(printed["files"]["report"]).read_text()
    assert all(text in report for text in texts)


def test_verdicts_name_the_step_and_say_what_was_not_judged(printed: dict[str, Any]) -> None:
    found, back, noise = printed["criteria"]
    assert (found["passed"], found["step"]) == (True, 1)
    assert (back["passed"], back["step"]) == (False, 2)
    assert noise["passed"]
    assert noise["reason"].startswith("not judged: step 3")
    cases = ElementTree.parse(printed["files"]["junit"]).getroot()
    assert len(cases.findall("testcase/failure")) == 1


def test_a_commit_is_named_and_whether_files_differ_from_it(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        command = ["git", "-C", str(tmp_path), "-c", "user.name=t", "-c", "user.email=t@example.org", *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    config = tmp_path / "bench.yaml"
    config.write_text("seed: 1\n")
    assert commit_of(config) is None
    git("init", "-q")
    assert commit_of(config) is None  # no commit yet
    git("add", "bench.yaml")
    git("commit", "-q", "-m", "a bench")
    found = commit_of(config)
    assert found is not None
    assert (found.commit, found.changed) == (git("rev-parse", "HEAD"), False)
    other = tmp_path / "not_part_of_it.yaml"
    other.write_text("seed: 2\n")
    assert commit_of(other) is not None
    assert commit_of(other).changed  # type: ignore[union-attr]
    config.write_text("seed: 3\n")
    assert commit_of(config).changed  # type: ignore[union-attr]


def test_what_a_program_of_the_checkout_could_do_is_not_run(tmp_path: Path) -> None:
    config = tmp_path / "bench.yaml"
    config.write_text("seed: 1\n")
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    hook, ran = tmp_path / "hook.sh", tmp_path / "ran"
    hook.write_text(f"#!/bin/sh\ntouch {ran}\n")
    hook.chmod(0o755)
    subprocess.run(["git", "-C", str(tmp_path), "config", "core.fsmonitor", str(hook)], check=True)
    commit_of(config)
    assert not ran.exists()


def test_overridden_is_what_options_gave() -> None:
    path = ROOT / "bench_configs" / "web_section_step.yaml"
    assert overridden(load_with_overrides(path).document) == []
    loaded = load_with_overrides(
        path, bus="embedded:other", changes=["machine.web.width_m=0.6", "machine.web.width_m=0.7"]
    )
    values = {each.key: (each.value, each.option) for each in overridden(loaded.document)}
    assert values == {"machine.web.width_m": (0.7, "--set"), "bus.address": ("embedded:other", "--bus")}
