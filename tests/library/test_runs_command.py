"""`hilbench runs` as one types it: found, shown, labelled, drawn, deleted."""

from __future__ import annotations

import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench
from tests.library.made_runs import criterion, made_run
from tests.report.test_html import recording, run_folder

from hilbench.results.run_folder import RunFolder


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Four runs, the third not passed."""
    for number in range(4):
        made_run(
            tmp_path,
            number=number,
            criteria=[criterion("E found", passed=number != 2, verifies=["REQ-1"])],
            settings={"load.web.width_m": 0.5 + 0.1 * number},
        )
    return tmp_path


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.is_dir())


def test_a_list_has_the_newest_first_and_what_was_asked_for_beside_it(runs: Path) -> None:
    done = hilbench("runs", "list", "--runs", runs, "--where", "E_time_to_1pct_s > 0.105")
    assert done.returncode == 0, done.stderr
    head, *lines = done.stdout.splitlines()
    assert head.split() == ["run", "began", "result", "criteria", "duration", "E_time_to_1pct_s", "tags", "set"]
    assert [line.split()[0] for line in lines] == names(runs)[:0:-1]
    assert lines[1].split()[3:] == ["failed", "0/1", "2.0", "s", "0.12", "load.web.width_m=0.7"]


def test_a_list_for_a_program_has_everything(runs: Path) -> None:
    found = json.loads(hilbench("runs", "list", "--runs", runs, "--result", "failed", "--json").stdout)
    (run,) = found["runs"]
    assert run["run"] == names(runs)[2]
    assert run["began"] == "2026-03-01T10:00:00+00:00"
    assert run["metrics"]["E_time_to_1pct_s"] == pytest.approx(0.12)
    assert run["settings"] == {"load.web.width_m": pytest.approx(0.7)}


def test_a_list_of_paths_is_for_other_commands(runs: Path) -> None:
    done = hilbench("runs", "list", "--runs", runs, "--paths", "--last", 2, "--sort", "E_time_to_1pct_s")
    assert done.stdout.split() == [str(runs / name) for name in names(runs)[:1:-1]]


def test_a_long_list_says_how_much_it_left_out(tmp_path: Path) -> None:
    for number in range(52):
        made_run(tmp_path, number=number)
    lines = hilbench("runs", "list", "--runs", tmp_path).stdout.splitlines()
    assert len(lines) == 1 + 50 + 1
    assert "50 of 52 runs" in lines[-1]
    assert len(json.loads(hilbench("runs", "list", "--runs", tmp_path, "--json").stdout)["runs"]) == 52


def test_one_run_is_shown_with_its_labels_and_files(runs: Path) -> None:
    newest = names(runs)[-1]
    assert hilbench("runs", "tag", newest, "--add", "golden", "--add", "stand7", "--runs", runs).returncode == 0
    assert hilbench("runs", "note", newest[:-2], "new <b>belt</b>", "--runs", runs).returncode == 0
    shown = hilbench("runs", "show", "last", "--runs", runs).stdout
    for text in (newest, "golden, stand7", "new <b>belt</b>", "E found", "0.1 s (≤ 0.2)", "REQ-1", "result.json"):
        assert text in shown
    labels = json.loads((runs / newest / "labels.json").read_text())  # goes where the folder goes
    assert labels["tags"] == ["golden", "stand7"]
    assert labels["notes"][0]["text"] == "new <b>belt</b>"
    taken = hilbench("runs", "tag", newest, "--remove", "golden", "--runs", runs)
    assert taken.stdout.strip() == f"{newest}: stand7"


def test_a_trend_is_told_and_drawn(runs: Path, tmp_path: Path) -> None:
    for number in range(4, 30):
        made_run(runs, number=number)
    picture = tmp_path / "trend.svg"
    done = hilbench("runs", "trend", "E_time_to_1pct_s", "--runs", runs, "--out", picture)
    assert "rising" in done.stdout
    assert ET.parse(picture).getroot().tag.endswith("svg")
    over = hilbench("runs", "trend", "E_noise_pct", "--over", "load.web.width_m", "--runs", runs, "--json")
    data = json.loads(over.stdout)
    assert (data["runs"], data["direction"]) == (4, "level")
    assert [point["load.web.width_m"] for point in data["points"]] == pytest.approx([0.5, 0.6, 0.7, 0.8])


def test_a_trend_says_how_many_runs_have_no_value(runs: Path) -> None:
    for number in range(4, 6):
        made_run(runs, number=number, metrics={"E_noise_pct": 0.02, "E_time_to_1pct_s": None})
    done = hilbench("runs", "trend", "E_time_to_1pct_s", "--runs", runs)
    assert "of 4 runs" in done.stdout
    assert "2 runs left out, without a value of E_time_to_1pct_s or began" in done.stdout
    assert json.loads(hilbench("runs", "trend", "E_time_to_1pct_s", "--runs", runs, "--json").stdout)["left_out"] == 2


def test_delete_needs_a_yes_where_nobody_can_be_asked(runs: Path) -> None:
    before = names(runs)
    refused = hilbench("runs", "delete", "--result", "failed", "--runs", runs)
    assert refused.returncode == 2
    assert "--yes" in refused.stderr
    assert names(runs) == before
    assert hilbench("runs", "delete", "--result", "failed", "--runs", runs, "--yes").returncode == 0
    assert names(runs) == [before[0], before[1], before[3]]
    assert hilbench("runs", "delete", runs / before[0], "--yes", "--runs", runs).returncode == 0
    assert names(runs) == [before[1], before[3]]


def test_delete_of_one_that_is_no_run_deletes_none(runs: Path, tmp_path: Path) -> None:
    before = names(runs)
    done = hilbench("runs", "delete", before[0], runs, "--yes", "--runs", runs)
    assert done.returncode == 2
    assert "no run folder" in done.stderr
    assert names(runs) == before


@pytest.mark.parametrize("options", [(), ("--json",)])
def test_gc_goes_on_past_a_run_that_may_not_be_deleted(runs: Path, options: tuple[str, ...]) -> None:
    before = names(runs)
    made_run(runs / before[0], "inside", number=1)
    done = hilbench("runs", "gc", "--older-than", "1d", "--keep-last", 1, "--yes", *options, "--runs", runs)
    assert done.returncode == 2
    assert f"{before[0]}: holds inside-" in done.stderr
    assert names(runs) == [before[0], before[3]]
    assert "2 runs deleted" in done.stdout or len(json.loads(done.stdout)["runs"]) == 2


def test_gc_says_first_what_would_go(runs: Path) -> None:
    before = names(runs)
    dry = hilbench("runs", "gc", "--older-than", "1d", "--keep-last", 1, "--dry-run", "--runs", runs)
    assert "would go: 3 runs" in dry.stdout
    assert names(runs) == before
    done = hilbench("runs", "gc", "--older-than", "1d", "--keep-last", 1, "--yes", "--json", "--runs", runs)
    assert [each["run"] for each in json.loads(done.stdout)["runs"]] == before[:3]
    assert names(runs) == before[3:]
    sized = hilbench("runs", "gc", "--max-size", "1kB", "--yes", "--runs", runs)
    assert sized.returncode == 0
    assert names(runs) == []


@pytest.mark.parametrize(
    "words",
    [
        ["list", "--where", "E >"],
        ["list", "--where", "nothing_like_it > 1"],
        ["list", "--metric", "E_nois_pct"],
        ["list", "--result", "great"],
        ["list", "--since", "yesterday"],
        ["show", "nowhere"],
        ["show", "web"],
        ["tag", "last"],
        ["tag", "last", "--add", "two words"],
        ["note", "last", " "],
        ["trend", "nothing"],
        ["trend", "E_noise_pct", "--over", "bench"],
        ["trend", "E_noise_pct", "--out", "x.bmp"],
        ["delete", "--yes"],
        ["delete", "last", "--result", "failed", "--yes"],
        ["gc", "--yes"],
        ["gc", "--max-size", "much", "--yes"],
        ["gc", "--older-than", "a while", "--yes"],
    ],
)
def test_what_can_not_be_meant_is_one_line(runs: Path, words: list[str]) -> None:
    before = names(runs)
    done = hilbench("runs", *words, "--runs", runs)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert "expected" in done.stderr
    assert names(runs) == before


def test_a_tag_in_the_labels_of_somebody_else_s_hand_is_no_terminal_command(runs: Path) -> None:
    folder = RunFolder(runs / names(runs)[0])
    folder.labels.write_text(json.dumps({"tags": ["\x07gone\r"], "notes": []}))
    os.utime(folder.path)
    for words in (["list"], ["show", folder.name]):
        printed = hilbench("runs", *words, "--runs", runs).stdout
        assert "gone" in printed
        assert not {"\x07", "\r"} & set(printed)


def test_a_run_is_meant_by_its_path_wherever_it_lies(runs: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    elsewhere = made_run(tmp_path_factory.mktemp("elsewhere"), "axis", number=1)
    shown = hilbench("runs", "show", elsewhere.path, "--runs", runs / "nowhere")
    assert shown.returncode == 0, shown.stderr
    assert "axis" in shown.stdout


def test_a_trend_of_a_single_run_is_a_point(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    made_run(tmp_path, number=1)
    done = hilbench("runs", "trend", "E_noise_pct", "--runs", tmp_path, "--out", tmp_path / "trend.png")
    assert "1 run over began: level" in done.stdout
    assert [str(each.message) for each in recwarn if "Locator" in str(each.message)] == []


def test_runs_are_compared_by_their_names(tmp_path: Path) -> None:
    one, other = (run_folder(tmp_path, recording(), metrics={"E_noise_pct": noise}) for noise in (0.1, 0.3))
    done = hilbench("compare", one.name, other.name, "--runs", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["metrics"]
    assert row["differences"] == [pytest.approx(0.2)]
