"""What the page shows of a run that goes on is what its recording has in the end."""

from __future__ import annotations

import fcntl
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hilbench.apps.library.live_run import LiveRun
from hilbench.apps.pages.live.history import History
from hilbench.apps.pages.live.listener import LiveSamples, event_of, live_panels, signals_of
from hilbench.bench.reports.change import Change
from hilbench.can.frame import Frame
from hilbench.results.journal import append_to_journal
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import RunOutcome
from hilbench.results.trace import TraceReader
from hilbench.runs.config import LoadedConfig

Ran = tuple[LoadedConfig, RunOutcome]


@dataclass
class GoingOn:
    """A run that is written again as its bench has written it, and heard."""

    folder: Path
    frames: Sequence[Frame]
    lines: Sequence[bytes]
    channel: str
    samples: LiveSamples
    history: History

    def go_on(self, first: int, last: int, received: bool = True) -> None:
        for at in range(first, last, 500):
            end = min(at + 500, last)
            with open(self.folder / "trace.log", "ab") as trace:
                trace.writelines(self.lines[at:end])
            if received:
                self.samples.take(self.frames[at:end])

    def signal(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        t_s, values = self.history._full.part(0, self.history._full.count)
        return t_s, values[:, self.history.names.index(name)]


@pytest.fixture
def going_on(ran: Ran, tmp_path: Path) -> Iterator[GoingOn]:
    loaded, outcome = ran
    folder = tmp_path / "runs" / "now"
    folder.mkdir(parents=True)
    shutil.copy(outcome.folder.config, folder)
    shutil.copy(outcome.folder.journal, folder)
    frames, lines = list(TraceReader(outcome.folder.trace)), outcome.folder.trace.read_bytes().splitlines(True)
    channel = lines[0].split()[1].decode()
    (folder / "trace.log").write_bytes(lines[0])
    history = History(signals_of(live_panels(loaded.config)), loaded.config.cycle_time_s)
    samples = LiveSamples(loaded.config, history, partial(LiveRun.on, tmp_path / "runs"), channel)
    with open(folder / "trace.log", "ab") as trace:
        fcntl.flock(trace, fcntl.LOCK_EX)  # as a bench holds it
        yield GoingOn(folder, frames, lines, channel, samples, history)


def recorded(ran: Ran) -> Recording:
    return read_recording(ran[1].folder.recording)


def compare(run: GoingOn, recording: Recording, name: str, tolerance: float) -> None:
    t_s, values = run.signal(name)
    known = np.isfinite(values)
    assert known.any(), name
    at = np.searchsorted(recording.time_s, t_s[known] - 1e-6)
    expected = np.asarray(recording[name])[at]
    assert np.max(np.abs(values[known] - expected)) <= tolerance * np.max(np.abs(expected)), name


def test_a_run_that_is_heard_from_its_start_is_shown_as_it_is_recorded(going_on: GoingOn, ran: Ran) -> None:
    going_on.go_on(1, len(going_on.frames))
    recording = recorded(ran)
    assert len(going_on.signal("F_true_N")[0]) >= len(recording.time_s) - 1
    for name in going_on.history.names:
        compare(going_on, recording, name, 1e-6 if "cmd" in name else 1e-7)  # commands come in the drives' units


def test_a_run_that_is_joined_under_way_has_its_time_and_its_set_points(going_on: GoingOn, ran: Ran) -> None:
    middle = len(going_on.frames) // 2
    going_on.go_on(1, middle, received=False)
    going_on.go_on(middle, len(going_on.frames))
    recording = recorded(ran)
    t_s, set_points = going_on.signal("F_ref_N")
    assert 1.5 < t_s[0] < 3.5
    assert np.all(set_points == 90.0)
    for name in ("v2_m_s", "tau2_Nm", "F_sim_N"):
        compare(going_on, recording, name, 1e-6)


def test_what_is_emulated_is_not_shown_before_it_is_right(going_on: GoingOn, ran: Ran) -> None:
    middle = len(going_on.frames) // 4
    going_on.go_on(1, middle, received=False)
    going_on.go_on(middle, len(going_on.frames))
    _, true = going_on.signal("F_true_N")
    assert np.isnan(true[:200]).all()
    compare(going_on, recorded(ran), "F_true_N", 2e-3)


def test_without_the_folder_of_the_run_what_no_frame_shows_is_not_made_up(going_on: GoingOn) -> None:
    shutil.rmtree(going_on.folder)
    going_on.samples.take(going_on.frames)
    assert np.isnan(going_on.signal("F_true_N")[1]).all()
    assert np.isnan(going_on.signal("F_ref_N")[1]).all()
    assert np.isfinite(going_on.signal("F_sim_N")[1]).all()


def test_the_events_of_a_run_are_those_of_its_journal(going_on: GoingOn) -> None:
    going_on.go_on(1, len(going_on.frames))
    said = [str(event) for event in going_on.samples.log.events()]
    assert "line speed 0 → 3 m/s" in said
    assert "set-point 80 → 90 N" in said
    assert [change.what for _, change in going_on.samples.reported()] == ["enabled", "stopping"]


def test_a_tension_loop_that_is_open_for_long_is_a_warning_of_the_page(going_on: GoingOn) -> None:
    append_to_journal(going_on.folder / "journal.log", Change(20, "loop_open", "tension loop", 0.01))
    going_on.go_on(1, len(going_on.frames))
    (entry,) = [event_of(change, t_s) for t_s, change in going_on.samples.reported() if change.what == "loop_open"]
    assert (entry.weight, entry.text) == ("warning", "tension loop open for long")


def test_the_next_run_is_another_one(going_on: GoingOn) -> None:
    going_on.go_on(1, len(going_on.frames))
    generation = going_on.history.generation
    shutil.rmtree(going_on.folder)
    going_on.samples.take(going_on.frames)
    assert going_on.history.generation == generation + 1
    assert going_on.samples.run is None
