"""Recordings of hardly any length: what reads them says what it can, or in one line why it can't."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import config, run_folders
from tests.cli.in_process import hilbench
from tests.tiers import slow

from hilbench.results.recording import Recording, read_recording, write_recording


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of 1.5 s."""
    ramp = {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.2}
    path = config(tmp_path_factory.mktemp("run"), steps=[{"ramp": ramp}, {"hold": {"duration_s": 1.3}}])
    assert hilbench("run", path, "--in-process", "--out", path.parent / "runs").returncode == 0
    return run_folders(path)[0]


def cut(run: Path, rows: int, path: Path) -> Path:
    """The first rows of the run's recording."""
    whole = read_recording(run / "recording.mf4")
    write_recording(Recording({name: each[:rows] for name, each in whole.channels.items()}, whole.start_time), path)
    return path


@pytest.mark.parametrize("rows", [0, 50, *slow(1, 2, 3, 4, 5, 500)])
@pytest.mark.parametrize("suffix", ["csv", *slow("mf4")])
def test_a_short_recording_is_used_or_refused_in_one_line(tmp_path: Path, run: Path, rows: int, suffix: str) -> None:
    recording, model = cut(run, rows, tmp_path / f"short.{suffix}"), run / "config.yaml"
    folder = tmp_path / "short_run"
    shutil.copytree(run, folder)
    cut(run, rows, folder / "recording.mf4")
    for words, usable in (
        (["sync", recording, "--model", model, "--method", "all"], False),
        (["sync", recording, "--model", model, "--out", tmp_path / "sync"], False),
        (["diagnose", recording, "--model", model, "--out", tmp_path / "found"], False),
        (["convert", recording, tmp_path / ("out.mf4" if suffix == "csv" else "out.csv")], rows > 1),
        (["compare", folder, run], rows > 1),
        (["compare", run, folder], rows > 1),
        (["report", folder], rows > 1),
    ):
        ended = hilbench(*words)
        assert ended.returncode == (0 if usable else 2), (words, ended)
        if usable:
            assert ended.stderr == "", words
        else:
            # What is being done stands before it, where that may take long.
            (said,) = [line for line in ended.stderr.splitlines() if not re.match(r" *[0-9.]+ s  ", line)]
            assert "expected" in said
            assert said.startswith(f"hilbench: {folder if folder in words else recording}")


def test_a_step_too_near_the_end_has_no_settled_figures(tmp_path: Path, run: Path) -> None:
    whole = read_recording(run / "recording.mf4")
    true = np.array(whole["E_true_Pa"])
    true[-100:] *= 1.1
    write_recording(Recording(dict(whole.channels) | {"E_true_Pa": true}, whole.start_time), tmp_path / "step.mf4")
    words = ["sync", tmp_path / "step.mf4", "--model", run / "config.yaml", "--method", "rls,pid"]
    ended = hilbench(*words, "--json")
    assert ended.returncode == 0, ended
    assert ended.stderr == ""
    found = json.loads(ended.stdout, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert {method["noise_pct"] for method in found["methods"]} == {None}
    assert hilbench(*words, "--out", tmp_path / "page").returncode == 0


@pytest.mark.parametrize("text", ["", ",", "rls,nobody"])
def test_no_method_is_refused(run: Path, text: str) -> None:
    ended = hilbench("sync", run / "recording.mf4", "--model", run / "config.yaml", "--method", text)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
    assert ended.stderr.startswith("hilbench: --method: ")
