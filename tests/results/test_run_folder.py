"""A run folder is always new, and named so that one finds it."""

from __future__ import annotations

import os
import stat
from datetime import datetime
from pathlib import Path

import pytest

from hilbench.errors import UnusableInputError
from hilbench.results.run_folder import RunFolder

NOON = datetime(2026, 3, 4, 12, 0, 1)


def test_name_and_paths(tmp_path: Path) -> None:
    folder = RunFolder.create(tmp_path / "runs", "web_section_step", NOON)
    assert folder.path == tmp_path / "runs" / "web_section_step-20260304-120001"
    assert folder.name == "web_section_step-20260304-120001"
    names = [path.name for path in (folder.config, folder.trace, folder.recording, folder.result, folder.report)]
    assert names == ["config.yaml", "trace.log", "recording.mf4", "result.json", "report.html"]
    assert {path.parent for path in (folder.config, folder.report)} == {folder.path}


def test_an_existing_run_is_never_touched(tmp_path: Path) -> None:
    folders = [RunFolder.create(tmp_path, "a", NOON) for _ in range(3)]
    assert [folder.path.name for folder in folders] == [f"a-20260304-120001{end}" for end in ("", "-2", "-3")]


@pytest.mark.parametrize(
    ("name", "start"),
    [("../../etc/passwd", "etc-passwd-2026"), ("größe 2 µm", "gr-e-2-m-2026"), ("", "run-2026"), ("..", "run-2026")],
)
def test_a_name_never_leaves_the_folder(tmp_path: Path, name: str, start: str) -> None:
    folder = RunFolder.create(tmp_path, name, NOON)
    assert folder.path.parent == tmp_path
    assert folder.path.name.startswith(start)
    assert len(RunFolder.create(tmp_path, "x" * 1000, NOON).path.name) < 150


def test_umask_holds(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        folder = RunFolder.create(tmp_path, "a")
    finally:
        os.umask(before)
    assert stat.S_IMODE(folder.path.stat().st_mode) == 0o700


def test_no_place_for_a_folder(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("a file")
    with pytest.raises(UnusableInputError, match="no run folder can be made here"):
        RunFolder.create(tmp_path / "runs", "a")


def test_open(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match=r"no config\.yaml in it, expected the folder of a run"):
        RunFolder.open(tmp_path)
    (tmp_path / "config.yaml").write_text("")
    assert RunFolder.open(tmp_path).path == tmp_path
