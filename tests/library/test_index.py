"""The index of a folder of runs: it says what the folders say, opens what has changed, and can go at any time."""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Self

import pytest
from tests.library.made_runs import criterion, made_run

from hilbench.apps.library import index as index_module
from hilbench.apps.library.index import FILE
from hilbench.apps.library.labels import note, tag
from hilbench.apps.library.query import Library, Query
from hilbench.errors import UnusableInputError
from hilbench.results.result import Fault


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Run folders that are read from now on."""
    found: list[str] = []
    read = index_module.read_entry
    monkeypatch.setattr(index_module, "read_entry", lambda base, path: found.append(path) or read(base, path))
    return found


def names(library: Library, **asked: object) -> list[str]:
    return [run.path for run in library.runs(Query.parse(**asked))]  # type: ignore[arg-type]


def test_runs_are_listed_with_what_their_folders_say(tmp_path: Path) -> None:
    made_run(tmp_path, "web", number=1, criteria=[criterion("a"), criterion("b", passed=False)])
    made_run(tmp_path, "axis", number=2, faults=[Fault(time_s=1.0, source="bench", text="node 3 is gone")])
    made_run(tmp_path, "web", number=3, faults=[Fault(time_s=1.0, source="operator", text="interrupted")])
    made_run(tmp_path, "web", number=4, settings={"load.web.width_m": 0.6})
    four, three, two, one = Library(tmp_path).runs()
    assert [run.state for run in (one, two, three, four)] == ["failed", "fault", "interrupted", "completed"]
    assert (one.bench, one.met, one.criteria, one.duration_s, one.seed) == ("web", 1, 2, 2.0, 1)
    assert (one.description, one.host, one.config) == ("made for tests", "stand7", "bench_configs/web.yaml")
    assert one.metrics == {"E_time_to_1pct_s": pytest.approx(0.11), "E_noise_pct": 0.02}
    assert two.fault == "node 3 is gone"
    assert four.settings == {"load.web.width_m": 0.6}
    assert one.began_s + 3 * 3600 == four.began_s


def test_a_folder_is_not_opened_again_until_it_has_changed(tmp_path: Path, opened: list[str]) -> None:
    folders = [made_run(tmp_path, number=number, criteria=[criterion("a")]) for number in range(20)]
    library = Library(tmp_path)
    assert len(library.runs()) == 20
    assert len(opened) == 20
    again = Library(tmp_path)
    assert len(again.runs()) == 20
    assert len(opened) == 20
    tag(folders[3], add=["golden"])
    note(folders[4], "look at the noise")
    data = json.loads(folders[5].result.read_text())
    folders[5].result.write_text(json.dumps(data | {"passed": False}))
    made_run(tmp_path, number=20)
    shutil.rmtree(folders[6].path)
    assert len(again.runs()) == 20
    assert len(opened) == 24
    assert names(again, tags=["golden"]) == [folders[3].name]
    assert names(again, results=["failed"]) == [folders[5].name]


def test_many_runs_cost_three_looks_each_and_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """How long a listing takes is told by what it does for each run."""
    first = made_run(tmp_path, number=0)
    for number in range(1, 300):
        shutil.copytree(first.path, tmp_path / f"copy-{number}")
    Library(tmp_path).runs()
    looks, real = [], os.stat
    monkeypatch.setattr(index_module.os, "stat", lambda path, *more, **named: looks.append(path) or real(path))
    monkeypatch.setattr(index_module, "read_entry", lambda *_: pytest.fail("a folder was opened that has not changed"))
    assert len(Library(tmp_path).runs(Query.parse(where="E_time_to_1pct_s < 1"))) == 300
    assert len(looks) <= 3 * 300 + 1  # and one for the folder itself


def test_the_index_is_made_again_when_it_is_gone_broken_or_of_another_version(tmp_path: Path) -> None:
    folder = made_run(tmp_path, number=1)
    tag(folder, add=["golden"])
    before = Library(tmp_path).runs()
    index = tmp_path / FILE
    index.unlink()
    assert Library(tmp_path).runs() == before
    data = json.loads(index.read_text())
    index.write_text(json.dumps(data | {"version": 99}))
    assert Library(tmp_path).runs() == before


def _set(key: int | str, value: object) -> Callable[[Path], None]:
    """Another value in the second run: its stamp, or one of its entry."""

    def damage(index: Path) -> None:
        data = json.loads(index.read_text())
        kept = list(data["runs"].values())[1]
        if isinstance(key, int):
            kept[key] = value
        else:
            kept[1][key] = value
        index.write_text(json.dumps(data))

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        lambda index: index.write_bytes(b"this is no index" * 100),
        lambda index: index.write_bytes(index.read_bytes()[:-100]),
        lambda index: index.write_bytes(index.read_bytes().replace(b'"bench"', b'"ben\xff"')),
        _set(0, None),
        _set(1, {}),
        _set("path", 1),
        _set("verdicts", 2),
        _set("a", "b"),
    ],
)
def test_a_damaged_index_is_made_again(tmp_path: Path, damage: Callable[[Path], None], opened: list[str]) -> None:
    for number in range(3):
        made_run(tmp_path, number=number)
    before = Library(tmp_path).runs()
    damage(tmp_path / FILE)
    assert Library(tmp_path).runs() == before
    assert len(opened) == 6
    assert Library(tmp_path).runs() == before
    assert len(opened) == 6  # it is kept again


def test_runs_with_odd_names_and_files_do_not_hide_the_others(tmp_path: Path) -> None:
    good = made_run(tmp_path, number=1)
    odd = made_run(tmp_path, number=2)
    os.rename(odd.path, os.fsencode(tmp_path) + b"/web-\xff")
    for number, (name, text) in enumerate(
        [
            ("result.json", None),
            ("labels.json", None),
            ("result.json", '{"began": "0001-01-01T00:00:00+14:00"}'),
            ("labels.json", '{"tags": ["\\ud800"]}'),
            ("config.yaml", "seed: 1" + "0" * 5000 + "\n"),
            ("config.yaml", "name: " + "[" * 5000 + "\n"),
            ("config.yaml", 'description: "\\ud800"\n'),
        ]
    ):
        folder = made_run(tmp_path, number=3 + number)
        path = folder.path / name
        path.unlink(missing_ok=True)
        if text is None:
            os.mkfifo(path)
        else:
            path.write_text(text)
    data = json.loads((folder := made_run(tmp_path, number=20)).result.read_text())
    data["timing"]["cycles"], data["metrics"] = 10**400, {"\ud800": 1.0}
    folder.result.write_text(json.dumps(data))
    found = {run.path: run for run in Library(tmp_path).runs()}
    assert len(found) == 10
    assert not found[good.name].problem
    assert "no UTF-8" in found["web-\\xff"].problem
    assert sum(bool(run.problem) for run in found.values()) >= 7
    for run in found.values():
        json.dumps(run.as_data(), ensure_ascii=False).encode()


def test_a_folder_that_ends_while_it_is_read_hides_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made_run(tmp_path)
    (tmp_path / "odd").mkdir()

    class Ends:
        """What `os.scandir` gives of a folder of /proc that may be opened and not read."""

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None: ...

        def __iter__(self) -> Iterator[os.DirEntry[str]]:
            raise PermissionError

    read = os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: Ends() if Path(path).name == "odd" else read(path))
    assert len(Library(tmp_path).runs()) == 1


def test_a_folder_that_can_not_be_written_is_listed_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made_run(tmp_path, number=1)

    def refused(*_: object) -> None:
        raise PermissionError(1, "no right")

    monkeypatch.setattr(Path, "write_bytes", refused)
    assert len(Library(tmp_path).runs()) == 1
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def _list(folder: Path, count: int) -> int:
    return min(len(Library(folder).runs()) for _ in range(count))


@pytest.mark.slow
def test_several_processes_list_while_runs_come(tmp_path: Path) -> None:
    for number in range(30):
        made_run(tmp_path, number=number)
    with multiprocessing.get_context("spawn").Pool(3) as pool:
        waiting = [pool.apply_async(_list, (tmp_path, 5)) for _ in range(3)]
        for number in range(30, 50):
            made_run(tmp_path, number=number)
        assert all(each.get(timeout=120) >= 30 for each in waiting)
    assert len(Library(tmp_path).runs()) == 50


def test_runs_of_sweeps_are_found_deeper_and_links_are_not_followed(tmp_path: Path) -> None:
    made_run(tmp_path / "sweep" / "1", number=1)
    (tmp_path / "loop").symlink_to(tmp_path)
    (tmp_path / "project").mkdir()
    (tmp_path / "project" / "config.yaml").write_text("a: 1\n")  # somebody's, and no run
    (run,) = Library(tmp_path).runs()
    assert run.path.startswith("sweep/1/web-")


@pytest.mark.parametrize("broken", [b"{", b"[]", b'{"passed": 1}', b'{"criteria": 3, "faults": [], "timing": {}}'])
def test_a_run_that_can_not_be_read_is_listed_with_the_reason(tmp_path: Path, broken: bytes) -> None:
    folder = made_run(tmp_path, number=1)
    folder.result.write_bytes(broken)
    (run,) = Library(tmp_path).runs()
    assert run.state == "unfinished"
    assert run.problem or broken == b"[]"


def test_a_run_without_a_result_goes_on_or_was_cut_off(tmp_path: Path) -> None:
    folder = made_run(tmp_path, number=1, finished=False)
    assert [run.state for run in Library(tmp_path).runs()] == ["running"]
    os.utime(folder.trace, (1.0, 1.0))
    assert [run.state for run in Library(tmp_path).runs()] == ["unfinished"]


def test_a_trace_that_its_bench_has_locked_is_of_a_run_that_goes_on(tmp_path: Path) -> None:
    from hilbench.results.trace import TraceWriter

    folder = made_run(tmp_path, number=1, finished=False)
    folder.trace.unlink()
    with TraceWriter(folder.trace, "can0"):
        os.utime(folder.trace, (1.0, 1.0))
        assert [run.state for run in Library(tmp_path).runs()] == ["running"]
    os.utime(folder.trace, (1.0, 1.0))
    assert [run.state for run in Library(tmp_path).runs()] == ["unfinished"]


def test_runs_are_found_by_name_bench_tag_time_and_what_they_measured(tmp_path: Path) -> None:
    web = [made_run(tmp_path, "web_step", number=number) for number in range(4)]
    axis = made_run(tmp_path, "axis", number=9, metrics={"J_error_pct": 2.0}, settings={"seed": 7})
    tag(web[1], add=["golden"])
    library = Library(tmp_path)
    assert names(library, bench="web_*") == [each.name for each in web[::-1]]
    assert names(library, name="axis-*") == [axis.name]
    assert names(library, tags=["golden"]) == [web[1].name]
    assert names(library, where="E_time_to_1pct_s > 0.115") == [web[3].name, web[2].name]
    assert names(library, where="J_error_pct > 1 and seed == 9") == [axis.name]
    assert names(library, where="E_time_to_1pct_s is None") == [axis.name]
    assert names(library, since="2026-03-01T10:30:00+00:00") == [axis.name, web[3].name]
    assert names(library, until="2026-03-01T08:30:00+00:00") == [web[0].name]
    with pytest.raises(UnusableInputError, match="did you mean 'E_time_to_1pct_s'"):
        library.runs(Query.parse(where="E_time_to_1pct > 0.1"))


def test_a_library_is_a_folder(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="no such folder"):
        Library(tmp_path / "nowhere")
