"""Terminals that know no UTF-8, pipes that close, full disks: what a command does that can not say what it wants to."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from unittest.mock import patch

import pytest
from tests.bench.whole_runs import config, run_folders
from tests.tiers import slow
from typer.main import get_command

from hilbench.apps.cli.main import command_line, main
from hilbench.results.result import Result

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"
SHORT = [{"ramp": {"path": "line_speed_m_s", "to": 0.5, "duration_s": 0.2}}, {"hold": {"duration_s": 0.3}}]
FULL = "hilbench: standard output cannot be written (No space left on device)\n"


def hilbench(*arguments: object, encoding: str = "utf-8", out: Path, typed: str = "") -> tuple[int, str]:
    """Exit code and standard error of a command whose standard output is a file (or device) in an encoding."""
    said = io.StringIO()
    with (
        open(out, "w", encoding=encoding) as stream,
        patch.object(sys, "argv", ["hilbench", *map(str, arguments)]),
        patch.object(sys, "stdout", stream),
        patch.object(sys, "stderr", said),
        patch.object(sys, "stdin", io.StringIO(typed)),
        pytest.raises(SystemExit) as end,
    ):
        main()
    return int(end.value.code or 0), said.getvalue()


def commands() -> list[list[str]]:
    """Every command, as words."""
    found, left = [], [([], get_command(command_line()))]
    while left:
        words, command = left.pop()
        found.append(words)
        left += [([*words, name], inner) for name, inner in getattr(command, "commands", {}).items()]
    return sorted(found)


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    path = config(folder, steps=SHORT, description="Grüße, 80 N·m ≥ 3 µ")
    code, said = hilbench("run", path, "--in-process", "--out", folder / "runs", out=folder / "said")
    assert code == 0, said
    return run_folders(path)[0]


def readers(folder: Path) -> list[list[object]]:
    """Commands that read files, and what they are given."""
    model = folder / "config.yaml"
    return [
        ["check", SHIPPED],
        ["check", SHIPPED, "--json"],
        ["check", folder / "missing…≥.yaml"],
        ["compare", folder, folder],
        ["report", folder],
        ["recover", folder],
        ["convert", folder / "trace.log", folder.parent / "t.asc"],
        ["convert", folder / "recording.mf4", folder.parent / "r.csv"],
        ["dbc", SHIPPED],
        ["config", "schema"],
        ["sync", folder / "recording.mf4", "--model", model, "--method", "rls"],
        ["sync", folder / "recording.mf4", "--model", model, "--method", "rls", "--json"],
        ["sync", folder / "recording.mf4", "--model", model, "--method", "résumé"],
        ["doctor", "--bus", "embedded:nobody-on-it"],
    ]


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory, run_folder: Path) -> list[tuple[list[object], int, str]]:
    """The readers, the exit code of each and what it prints on a terminal that knows everything."""
    out, found = tmp_path_factory.mktemp("usual") / "utf-8", []
    for words in [*readers(run_folder), ["--help"], ["--version"]]:
        code, _ = hilbench(*words, out=out)
        found.append((words, code, out.read_text(encoding="utf-8")))
    return found


@pytest.mark.parametrize("words", commands(), ids=" ".join)
@pytest.mark.parametrize("encoding", ["ascii", *slow("latin-1")])
def test_help_is_readable_on_a_terminal_without_utf_8(tmp_path: Path, words: list[str], encoding: str) -> None:
    code, said = hilbench(*words, "--help", encoding=encoding, out=tmp_path / "out")
    text = (tmp_path / "out").read_text(encoding=encoding)
    assert (code, said) == (0, "")
    assert "Usage" in text
    assert not re.search(r"\\u[0-9a-f]{4}", text), "a character without a way to type it"


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_commands_say_the_same_on_a_terminal_without_utf_8(
    tmp_path: Path, usual: list[tuple[list[object], int, str]], encoding: str
) -> None:
    for words, expected, said_in_full in usual:
        assert expected in (0, 1, 2), words
        code, said = hilbench(*words, encoding=encoding, out=tmp_path / "other")
        assert code == expected, (words, said)
        assert "unexpected" not in said
        text = (tmp_path / "other").read_text(encoding=encoding)
        assert len(text) >= 0.9 * len(said_in_full), words
        assert "\\u" not in text or "--json" in words or "schema" in words
        if "--json" in words and expected == 0:
            assert json.loads(text)


@pytest.mark.parametrize("encoding", ["ascii", *slow("latin-1")])
@pytest.mark.parametrize("options", [[], *slow(["--json"])])
def test_a_run_passes_on_a_terminal_without_utf_8(tmp_path: Path, encoding: str, options: list[str]) -> None:
    path = config(tmp_path, steps=SHORT, description="Grüße ≥ 3 µ")
    out = tmp_path / "runs"
    code, said = hilbench("run", path, "--in-process", "--out", out, *options, encoding=encoding, out=tmp_path / "said")
    assert (code, said) == (0, "")
    text = (tmp_path / "said").read_text(encoding=encoding)
    (folder,) = run_folders(path)
    if options:
        printed = {key: value for key, value in json.loads(text).items() if key in Result.model_fields}
        assert Result.model_validate(printed) == Result.read(folder / "result.json")
    else:
        assert "completed, nothing judged" in text


@pytest.mark.slow
def test_standard_output_on_a_full_disk_is_one_line_and_exit_code_3(
    usual: list[tuple[list[object], int, str]],
) -> None:
    for words, expected, said_in_full in usual:
        code, said = hilbench(*words, out=Path("/dev/full"))
        if not said_in_full:
            assert code == expected
            continue
        assert said.endswith(FULL), words
        assert said.count(FULL) == 1
        assert code in (expected or 3, 3), words


@pytest.mark.slow
def test_a_run_whose_output_fails_on_the_way_stops_its_drives_and_writes_its_result(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[SHORT[0], {"hold": {"duration_s": 600.0}}])
    command = [sys.executable, "-m", "hilbench", "run", str(path), "--in-process", "--out", str(tmp_path / "runs")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        while not process.stdout.readline().startswith("t  "):
            assert process.poll() is None
        process.stdout.close()  # as head does when it has seen enough
        said = process.stderr.read()
    assert process.returncode == 3
    assert said == "hilbench: standard output cannot be written (Broken pipe)\n"
    (folder,) = run_folders(path)
    (fault,) = Result.read(folder / "result.json").faults
    assert fault.text == "standard output cannot be written (Broken pipe)"
    assert fault.time_s is not None
    assert (folder / "recording.mf4").exists()


@pytest.mark.slow
@pytest.mark.parametrize("closed", ["<&- >&- 2>&-", "<&-", ">&-", "2>&-"])
def test_a_command_with_a_standard_stream_closed_does_its_work(tmp_path: Path, closed: str) -> None:
    path = config(tmp_path, steps=SHORT)
    line = f"{sys.executable} -m hilbench run {path} --in-process --no-report --out {tmp_path}/runs {closed}"
    ended = subprocess.run(["sh", "-c", line], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended
    (folder,) = run_folders(path)
    assert Result.read(folder / "result.json").verdict == "completed"
    assert b"completed" not in (folder / "trace.log").read_bytes()  # standard output was no file of the run


def test_a_file_name_that_is_no_text_is_told_all_the_same(tmp_path: Path) -> None:
    name = os.fsdecode(b"bench-\xff.yaml")
    code, said = hilbench("check", tmp_path / name, out=tmp_path / "out")
    assert code == 2
    assert "bench-\\udcff.yaml" in said


@pytest.mark.slow
def test_a_command_in_a_locale_that_knows_ascii_only(tmp_path: Path) -> None:
    path = config(tmp_path, steps=SHORT, description="Grüße ≥ 3 µ")
    environment = {**os.environ, "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    command = [sys.executable, "-m", "hilbench", "run", str(path), "--in-process", "--out", str(tmp_path / "runs")]
    ended = subprocess.run(command, capture_output=True, env=environment, check=False)
    assert ended.returncode == 0, ended
    assert ended.stderr == b""
    assert ended.stdout.isascii()
    assert (run_folders(path)[0] / "report.html").exists()


def test_what_nobody_foresaw_in_a_command_is_one_line_with_its_traceback_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HILBENCH_TRACEBACKS", str(tmp_path))
    for error in (KeyError("what"), BrokenPipeError(32, "Broken pipe"), OSError(24, "Too many open files")):
        with patch("hilbench.apps.commands.check.check_experiment", side_effect=error):
            code, said = hilbench("check", SHIPPED, out=tmp_path / "out")
        assert code == 3
        assert said.count("\n") == 1
        match = re.fullmatch(rf"hilbench: unexpected {type(error).__name__} in .*: .*; traceback in (.*)\n", said)
        assert match is not None, said
        assert "check_experiment" in Path(match[1]).read_text()
    monkeypatch.setenv("HILBENCH_TRACEBACKS", str(tmp_path / "nowhere"))
    with patch("hilbench.apps.commands.check.check_experiment", side_effect=KeyError("what")):
        code, said = hilbench("check", SHIPPED, out=tmp_path / "out")
    assert (code, said.count("\n")) == (3, 1)
    assert "its traceback can't be kept (No such file or directory)" in said


def test_a_thread_that_nobody_foresaw_to_end_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HILBENCH_TRACEBACKS", str(tmp_path))

    def with_thread(*arguments: object, **options: object) -> None:
        thread = threading.Thread(target=lambda: {}["what"])
        thread.start()
        thread.join()

    with patch("hilbench.apps.commands.check.check_command", side_effect=with_thread):
        code, said = hilbench("check", SHIPPED, out=tmp_path / "out")
    assert code == 0
    assert re.fullmatch(r"hilbench: unexpected KeyError in .*: 'what'; traceback in .*\n", said)
