"""`hilbench examples` and what commands say of files that only an example has."""

from __future__ import annotations

import errno
import re
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench
from tools.reference import commands_page

from hilbench.runs.examples import names


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_examples_are_listed_with_what_they_show():
    done = hilbench("examples")
    assert done.returncode == 0, done.stderr
    assert "web_section_step " in done.stdout
    assert "Young's modulus steps by 20.7 %" in " ".join(done.stdout.split())


def test_an_example_comes_with_what_it_includes_and_its_eds_files(tmp_path):
    done = hilbench("examples", "web_section_step_pid", "scenario")
    assert done.stdout.splitlines() == ["bench_configs/web_section_step_pid.yaml", "bench_configs/scenario.yaml"]
    for name in ("web_section_step_pid", "scenario"):
        checked = hilbench("check", tmp_path / "bench_configs" / f"{name}.yaml")
        assert checked.returncode == 0, checked.stderr


def test_a_file_that_is_there_is_kept(tmp_path):
    mine = tmp_path / "bench_configs" / "web_section_step.yaml"
    mine.parent.mkdir()
    mine.write_text("mine")
    assert hilbench("examples", "web_section_step").returncode == 0
    assert mine.read_text() == "mine"


def test_every_example_can_be_checked(tmp_path):
    assert hilbench("examples", "--all").returncode == 0
    # The FMU is built first, and what is published/ are models alone.
    configs = [name for name in names() if "/" not in name]
    assert len(configs) > 30
    for name in configs:
        checked = hilbench("check", f"bench_configs/{name}.yaml")
        assert checked.returncode == 0, f"{name}: {checked.stderr}"


def test_every_file_that_help_names_is_one_of_the_examples(tmp_path):
    assert hilbench("examples", "--all").returncode == 0
    eds = {path.name for path in (tmp_path / "eds").iterdir()}
    assert "hilbench_servo.eds" in eds
    for path in re.findall(r"(?:bench_configs|eds)/[\w/]+\.\w+", commands_page()):
        assert (tmp_path / path).is_file() or "my_" in path or "schema" in path, path


def test_a_misspelt_example_and_a_config_that_is_only_shipped_say_what_to_type():
    assert "did you mean 'web_section_step'?" in hilbench("examples", "web_sectio_step").stderr
    done = hilbench("run", "bench_configs/winding_line.yaml")
    assert done.returncode == 2
    assert "hilbench examples winding_line" in done.stderr


def test_examples_where_nothing_can_be_written_is_one_line(tmp_path):
    (tmp_path / "bench_configs").write_text("a file where the folder should be")
    done = hilbench("examples", "web_section_step")
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1


def test_a_full_disk_is_one_line_and_leaves_no_part_of_a_file(tmp_path, monkeypatch):
    def full(self, data):
        raise OSError(errno.ENOSPC, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    done = hilbench("examples", "web_section_step")
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "bench_configs/web_section_step.yaml: cannot be written (No space left on device)" in done.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_help_flows_to_the_width_of_the_terminal(monkeypatch):
    sentence = "What is found in a run of a bench goes into its folder (diagnosis.json) and the history of its stand."
    for columns, lines in ((70, 3), (200, 1)):
        monkeypatch.setenv("COLUMNS", str(columns))
        shown = [line.strip() for line in hilbench("diagnose", "--help").stdout.splitlines()]
        begin = next(number for number, line in enumerate(shown) if line.startswith("What is found"))
        paragraph = shown[begin : shown.index("", begin)]
        assert sentence in " ".join(paragraph)
        assert len(paragraph) == lines
