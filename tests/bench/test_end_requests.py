"""Ctrl-C, SIGTERM and SIGHUP while a bench stops its drives, or its results are written."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator

import pytest
from tests.bench.whole_runs import ENDLESS, config, result_of, run_folders, run_here

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


class NotHeldError(Exception):
    """A signal acted."""


@pytest.fixture(autouse=True)
def told() -> Iterator[None]:
    """What acts on a signal that is not held, in place of the end of all tests."""

    def act(number: int, _frame: object) -> None:
        raise NotHeldError(signal.Signals(number).name)

    before = {number: signal.signal(number, act) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def sending(number: signal.Signals, *moments: str) -> Callable[[str], None]:
    """The signal comes as each of these is announced."""

    def announce(text: str) -> None:
        if text in moments:
            signal.raise_signal(number)

    return announce


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_while_results_are_written_waits_for_them_and_is_told(tmp_path, capfd, number):
    loaded = load_with_overrides(config(tmp_path))
    announce = sending(number, "disable drives", "write recording and result")
    outcome = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS, announce=announce)
    assert outcome.exit_code == 130
    assert len(read_recording(outcome.folder.recording)) > 1000
    assert result_of(outcome.folder.path).verdict == "completed", "the experiment was over"
    assert outcome.folder.junit.exists()
    stopping, writing = capfd.readouterr().err.splitlines()
    assert stopping.startswith(f"hilbench: {number.name} waits: the drives are brought to a stop (for 0.")
    assert writing.startswith(f"hilbench: {number.name} waits: recording and result are written (for ")


@pytest.mark.parametrize("number", SIGNALS)
def test_a_second_signal_in_the_quick_stop_waits_for_it_and_is_told(tmp_path, capfd, number):
    loaded = load_with_overrides(config(tmp_path, steps=ENDLESS))
    announce = sending(number, "run the experiment", "quick stop")
    outcome = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS, announce=announce)
    assert outcome.exit_code == 130
    assert [fault.source for fault in result_of(outcome.folder.path).faults] == ["operator"]
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"hilbench: {number.name} waits: the drives are brought to a stop (for 0.")


def test_ctrl_c_while_the_report_is_written_waits_for_it(tmp_path, capfd, monkeypatch):
    from hilbench.apps.report import html

    write = html.write_report

    def interrupted(folder):
        signal.raise_signal(signal.SIGINT)
        return write(folder)

    monkeypatch.setattr(html, "write_report", interrupted)
    path = config(tmp_path)
    code, out, _ = run_here(path, report=True)
    assert code == 130
    (folder,) = run_folders(path)
    assert (folder / "report.html").exists()
    assert "report.html" in out.replace("\n", "")
    assert "SIGINT waits: report and history are written" in capfd.readouterr().err


def test_ctrl_c_in_a_script_that_leaves_its_bench_acts_once_all_is_written(tmp_path, capfd):
    announce = sending(signal.SIGINT, "disable drives")
    with (
        pytest.raises(NotHeldError),
        Bench(
            config(tmp_path), participants=Participants.IN_PROCESS, out=tmp_path / "runs", announce=announce
        ) as bench,
    ):
        bench.run(0.5)
    assert bench.folder is not None
    assert result_of(bench.folder.path).faults == []
    assert "SIGINT waits: the drives are brought to a stop" in capfd.readouterr().err
