"""The processes beside a bench have programs of their own, which read the config that the bench has resolved."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from tests.bench.test_runs import config
from tests.tiers import slow

from hilbench.runs.config import load
from hilbench.topology.resolved import read_resolved, write_resolved


def ended(program: str, *words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", program, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("program", ["hilbench.twin", *slow("hilbench.hardware")])
def test_a_child_that_can_not_use_its_config_says_why_in_one_line(tmp_path: Path, program: str) -> None:
    missing = ended(program, tmp_path / "config.yaml", "--pace", "lockstep")
    assert missing.returncode == 2
    assert missing.stderr.splitlines() == [
        f"hilbench: {tmp_path}/config.yaml: cannot be read (No such file or directory), expected a YAML file"
    ]
    path = config(tmp_path, cycle_time_s=7.0)
    refused = ended(program, path)
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
    assert "'cycle_time_s' is 7.0" in refused.stderr


def test_children_read_the_bench_that_was_resolved_without_its_experiment(tmp_path: Path) -> None:
    experiment, _ = load(config(tmp_path, seed=11))
    path = tmp_path / "resolved.yaml"
    write_resolved(experiment, path)
    read = read_resolved(path)
    assert experiment.steps
    assert "steps" in yaml.safe_load(path.read_text())
    assert read.model_dump() == {
        name: value for name, value in experiment.model_dump().items() if name in type(read).model_fields
    }


def test_a_file_that_is_there_is_that_of_the_run(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text("name: mine\n")
    write_resolved(load(config(tmp_path))[0], path)
    assert path.read_text() == "name: mine\n"
