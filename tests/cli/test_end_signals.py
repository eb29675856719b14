"""A command is asked to end while it writes a file: the old one is left, or the new one, and never half of one."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench
from tests.library.made_runs import made_run

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture
def asked_half_way(monkeypatch: pytest.MonkeyPatch):
    """A function after which a signal comes when half of a text has been written into a file."""
    write = Path.write_text

    def begin(number: signal.Signals) -> None:
        def half(path: Path, text: str, **options: str) -> int:
            write(path, text[: len(text) // 2], **options)
            signal.raise_signal(number)
            return write(path, text, **options)

        monkeypatch.setattr(Path, "write_text", half)

    return begin


@pytest.mark.parametrize("number", CODES)
@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("config", "schema", "--out"), "bench.schema.json"),
        (("dbc", CONFIG, "--out"), "bench.dbc"),
    ],
)
def test_a_file_that_is_written_over_is_as_it_was_when_the_command_is_ended(
    tmp_path, asked_half_way, words, name, number
):
    path = tmp_path / name
    path.write_text("of yesterday\n")
    asked_half_way(number)
    done = hilbench(*words, path)
    assert done.returncode == CODES[number]
    (line,) = done.stderr.splitlines()
    assert line.startswith("hilbench: interrupted")
    assert path.read_text() == "of yesterday\n"
    assert list(tmp_path.iterdir()) == [path], "half of a file is left"


def test_a_new_config_is_not_there_when_writing_it_was_interrupted(tmp_path, asked_half_way):
    asked_half_way(signal.SIGTERM)
    done = hilbench("config", "new", tmp_path / "mine.yaml", "--eds", ROOT / "eds", "--defaults")
    assert (done.returncode, done.stderr) == (143, "hilbench: interrupted (SIGTERM)\n")
    assert list(tmp_path.iterdir()) == []


def test_a_page_of_runs_is_as_it_was_when_writing_it_was_interrupted(tmp_path, asked_half_way):
    made_run(tmp_path / "runs", number=1)
    page = tmp_path / "runs.html"
    assert hilbench("runs", "list", "--runs", tmp_path / "runs", "--html", page).returncode == 0
    before = page.read_bytes()
    asked_half_way(signal.SIGHUP)
    assert hilbench("runs", "list", "--runs", tmp_path / "runs", "--html", page).returncode == 129
    assert page.read_bytes() == before


@pytest.mark.parametrize("number", CODES)
def test_a_program_that_waits_is_ended_with_the_code_of_the_signal_and_one_line(tmp_path, number):
    command = [sys.executable, "-m", "hilbench", "config", "new", tmp_path / "mine.yaml", "--eds", ROOT / "eds"]
    asking = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert asking.stdout is not None
    assert asking.stdout.read(4) == b"name"
    asking.send_signal(number)
    _, err = asking.communicate(timeout=60)
    assert asking.returncode == CODES[number]
    assert err.startswith(b"hilbench: interrupted")
    assert err.count(b"\n") == 1


def test_a_program_under_nohup_does_not_end_when_its_terminal_hangs_up():
    program = """if True:
        import signal, sys
        from hilbench.exit_status import ended
        sys.exit(ended(lambda: signal.raise_signal(signal.SIGHUP)))
    """
    done = subprocess.run(["nohup", sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert done.returncode == 0


def test_what_is_a_link_or_no_file_is_written_where_it_leads_and_keeps_its_rights(tmp_path):
    real, link = tmp_path / "real.json", tmp_path / "link.json"
    real.write_text("of yesterday\n")
    real.chmod(0o640)
    link.symlink_to(real)
    assert hilbench("config", "schema", "--out", link).returncode == 0
    assert link.is_symlink()
    assert "properties" in json.loads(real.read_text())
    assert os.stat(real).st_mode & 0o777 == 0o640
    assert hilbench("config", "schema", "--out", "/dev/null").returncode == 0
