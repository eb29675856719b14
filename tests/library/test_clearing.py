"""What is deleted: runs and nothing else, and of these only what nobody wanted to keep."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from tests.library.made_runs import FIRST, made_run

from hilbench.apps.library.labels import note, tag
from hilbench.apps.library.query import Library
from hilbench.apps.library.retention import Keep, delete, to_clear
from hilbench.errors import UnusableInputError
from hilbench.results.run_folder import RunFolder

NOW_S = FIRST.timestamp() + 10 * 3600.0


def cleared(folder: Path, keep: Keep) -> list[str]:
    return [run.path for run, _ in to_clear(Library(folder).runs(), keep, NOW_S)]


@pytest.fixture
def ten(tmp_path: Path) -> list[RunFolder]:
    """An hour apart, the last an hour ago, each of some 100 kB."""
    return [made_run(tmp_path, number=number, trace_bytes=100_000) for number in range(10)]


def test_what_is_older_goes(tmp_path: Path, ten: list[RunFolder]) -> None:
    assert cleared(tmp_path, Keep(younger_than_s=7.5 * 3600)) == [each.name for each in ten[:3]]


def test_the_oldest_go_until_the_rest_fits(tmp_path: Path, ten: list[RunFolder]) -> None:
    assert cleared(tmp_path, Keep(size_bytes=450_000)) == [each.name for each in ten[:6]]


def test_the_newest_of_each_bench_stay_and_what_has_a_tag_or_a_note(tmp_path: Path, ten: list[RunFolder]) -> None:
    tag(ten[0], add=["golden"])
    note(ten[4], "the belt slipped")
    axis = [made_run(tmp_path, "axis", number=number) for number in (0, 1)]
    keep = Keep(younger_than_s=0.0, last=1)
    assert set(cleared(tmp_path, keep)) == {*(each.name for each in (*ten[1:4], *ten[5:9])), axis[0].name}
    assert {ten[0].name, ten[4].name} <= set(cleared(tmp_path, Keep(younger_than_s=0.0, last=1, labelled=False)))


def test_a_run_that_goes_on_stays(tmp_path: Path) -> None:
    made_run(tmp_path, number=0, finished=False)
    assert cleared(tmp_path, Keep(younger_than_s=0.0)) == []


def test_a_run_is_deleted_whole(tmp_path: Path, ten: list[RunFolder]) -> None:
    delete(ten[0].path)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(each.name for each in ten[1:])


@pytest.mark.parametrize("kind", ["empty", "project", "link", "several", "checkout", "running", "nowhere"])
def test_what_is_no_run_folder_is_left_alone(tmp_path: Path, kind: str) -> None:
    run = made_run(tmp_path, "run", number=1)
    path = tmp_path / kind
    if kind == "link":
        path.symlink_to(run.path)
    elif kind == "running":
        path = made_run(tmp_path, kind, number=2, finished=False).path
    elif kind != "nowhere":
        path.mkdir()
    if kind == "project":
        (path / "config.yaml").write_text("name: mine\n")
        (path / "thesis.tex").write_text("years of work")
    if kind in ("several", "checkout"):
        os.rename(run.path, path / "run")
        for name in ("config.yaml", "trace.log"):
            (path / name).write_text("name: x\n")
    if kind == "checkout":
        os.rename(path / "run", path / ".git")
    with pytest.raises(UnusableInputError, match="expected"):
        delete(path)
    assert kind == "nowhere" or path.exists()


def test_a_list_of_runs_that_others_delete_meanwhile_is_still_a_list(tmp_path: Path, ten: list[RunFolder]) -> None:
    library = Library(tmp_path)
    assert len(library.runs()) == 10
    delete(ten[2].path)
    assert len(library.runs()) == 9
