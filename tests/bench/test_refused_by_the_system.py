"""What the operating system refuses a run: few file handles, something else where the bus has its files. One line."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from tests.bench.whole_runs import SHORT, config, run_folders
from tests.tiers import slow

from hilbench.results.result import Result


def run(path: Path, runtime: Path, *options: str, files: int | None = None) -> subprocess.CompletedProcess[str]:
    """A run with a runtime directory of its own, and so many file handles."""
    runtime.mkdir(exist_ok=True)

    def limit() -> None:
        if files is not None:
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

    return subprocess.run(
        [sys.executable, "-m", "hilbench", "run", str(path), "--out", str(path.parent / "runs"), *options],
        env={**os.environ, "XDG_RUNTIME_DIR": str(runtime)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        preexec_fn=limit,
    )


@pytest.mark.parametrize("files", slow(8, 12, 14, 16))
def test_a_run_with_few_file_handles_is_a_fault_that_says_so(tmp_path: Path, files: int) -> None:
    path = config(tmp_path, steps=[SHORT[0]])
    ended = run(path, tmp_path / "run", files=files)
    assert ended.returncode in (0, 2, 3), ended  # how many it needs is the interpreter's to know
    assert "Traceback" not in ended.stdout + ended.stderr
    if ended.returncode:
        assert "Too many open files" in ended.stdout.replace("\n", " ") + ended.stderr
    for folder in run_folders(path):
        if (folder / "trace.log").exists():  # it had begun
            assert Result.read(folder / "result.json").passed == (ended.returncode == 0)


def test_a_run_with_hardly_any_file_handle_is_one_line(tmp_path: Path) -> None:
    ended = run(config(tmp_path), tmp_path / "run", files=5)
    assert ended.returncode == 3, ended
    assert ended.stderr.count("\n") == 1
    assert "Too many open files" in ended.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["{channel}.sock", ".lock", "{channel}.log"])
def test_a_directory_where_a_file_of_the_bus_should_be_is_named(tmp_path: Path, name: str) -> None:
    path = config(tmp_path, bus={"address": "embedded:values-taken"})
    taken = tmp_path / "run" / "hilbench" / name.format(channel="values-taken")
    taken.mkdir(parents=True)
    taken.parent.chmod(0o700)
    ended = run(path, tmp_path / "run")
    assert ended.returncode in (2, 3), ended
    said = ended.stdout.replace("\n", "") + ended.stderr
    assert "irectory" in said
    assert taken.name in said
    assert "Traceback" not in said
    assert "unexpected" not in said
    for folder in run_folders(path):
        assert Result.read(folder / "result.json").faults


def test_a_file_where_the_directory_of_the_bus_should_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "hilbench").write_text("")
    ended = run(config(tmp_path), tmp_path / "run")
    assert ended.returncode in (2, 3), ended
    assert str(tmp_path / "run" / "hilbench") in ended.stdout.replace("\n", "") + ended.stderr
    assert "Traceback" not in ended.stdout + ended.stderr
