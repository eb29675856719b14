"""A bench that is killed in mid-run loses nothing but its last cycle or two: `hilbench recover`."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import SHORT, config, gone, recover, run_folders, run_here, start, wait_for_frames

from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import Recording, read_recording
from hilbench.results.recover import recover_run
from hilbench.results.result import Result
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

#: Told to the drives in whole device units: 0.0001 rpm at the motor, at the web.
COMMANDED = ("v1_cmd_m_s", "v2_cmd_m_s")
RESOLUTION_M_S = 0.0001 / 60.0 * 2.0 * np.pi * 0.2 / 5.0


def same(whole: Recording, found: Recording, rows: int) -> None:
    """So many rows from the start are; commands are told to the drives in whole units."""
    for name in whole.channels:
        one, two = np.asarray(whole[name])[:rows], np.asarray(found[name])[:rows]
        if name in COMMANDED:
            assert np.max(np.abs(one - two)) <= RESOLUTION_M_S, name
        else:
            assert np.array_equal(one, two), name


def test_a_run_whose_trace_breaks_off_in_mid_line_is_recovered_as_far_as_it_goes(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path, steps=[*SHORT[:3], {"hold": {"duration_s": 0.4}}]))
    folder = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS).folder
    whole = read_recording(folder.recording)
    for path in (folder.recording, folder.result):
        path.unlink()
    lines = folder.trace.read_bytes().splitlines(keepends=True)
    syncs = [number for number, line in enumerate(lines) if b" 080#" in line]
    folder.trace.write_bytes(b"".join(lines[: syncs[400]]) + lines[syncs[400]][:20])
    done = recover(folder.path)
    assert done.returncode == 0, done.stderr
    found = read_recording(folder.recording)
    assert 300 < len(found) <= 400
    assert np.ptp(np.asarray(found["E_true_Pa"])) > 1e9
    same(whole, found, len(found) - 1)  # the last cycle is cut off, too
    result = Result.read(folder.result)
    assert not result.passed
    assert "cut off" in result.faults[0].text
    again = recover(folder.path)
    assert again.returncode == 2
    assert "there already" in again.stderr


@pytest.mark.slow
def test_a_killed_run_is_recovered_as_it_would_have_been_recorded(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[*SHORT[:3], {"hold": {"duration_s": 1.0}}])
    assert run_here(path)[0] == 0
    whole = read_recording(run_folders(path)[0] / "recording.mf4")
    (tmp_path / "killed").mkdir()
    path = config(tmp_path / "killed", steps=[*SHORT[:3], {"hold": {"duration_s": 1000.0}}])
    process = start(path)
    folder = wait_for_frames(path, random.Random(6).randrange(600, 1000))
    assert "still being written" in recover(folder).stderr
    process.kill()
    process.communicate(timeout=60)
    assert gone(path)
    syncs = (folder / "trace.log").read_bytes().count(b" 080#")
    done = recover(folder)
    assert done.returncode == 0, done.stderr
    found = read_recording(folder / "recording.mf4")
    # The cycles before the drives are enabled are in no recording.
    first = syncs - len(found)
    assert first < 60
    rows = min(len(found), len(whole))
    assert rows > 500
    assert np.ptp(np.asarray(found["E_true_Pa"])[:rows]) > 1e9
    same(whole, found, rows)
    result = Result.read(folder / "result.json")
    assert not result.passed
    assert "cut off" in result.faults[0].text
    assert "cut off" in (folder / "result.xml").read_text()
    assert "cut off" in (folder / "report.html").read_text()
    again = recover(folder)
    assert again.returncode == 2
    assert "there already" in again.stderr


def test_a_run_whose_twin_was_away_is_recovered_with_the_loop_open_and_closed_as_it_was(tmp_path: Path) -> None:
    steps = [*SHORT[:2], {"hold": {"duration_s": 1.5}}, {"restart_twin": {}}, {"hold": {"duration_s": 1.5}}]
    loaded = load_with_overrides(config(tmp_path, steps=steps))
    folder = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS).folder
    whole = read_recording(folder.recording)
    closed = np.asarray(whole["loop_closed"], np.int64)
    assert np.count_nonzero(np.diff(closed) < 0) >= 1  # it opened under way
    folder.recording.unlink()
    folder.result.unlink()
    recover_run(folder)
    found = read_recording(folder.recording)
    for name in whole.channels.keys() - {*COMMANDED, "bus_bits"}:
        assert np.array_equal(np.asarray(whole[name]), np.asarray(found[name])), name
    # The frames of the restart itself, between two cycles, are in the trace, but are no cycle's to the bench.
    assert np.count_nonzero(np.asarray(whole["bus_bits"]) != np.asarray(found["bus_bits"])) == 1


def test_without_its_journal_a_run_has_what_the_frames_say_and_nothing_is_invented(tmp_path: Path) -> None:
    loaded = load_with_overrides(config(tmp_path))
    folder = run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS).folder
    whole = read_recording(folder.recording)
    for path in (folder.recording, folder.result, folder.journal):
        path.unlink()
    recover_run(folder)
    found = read_recording(folder.recording)
    rows = len(whole)
    for name in ("x1_m", "tau2_Nm", "tau_load_Nm", "F_sim_N", "E_sim_Pa", "bus_bits"):
        assert np.array_equal(np.asarray(whole[name]), np.asarray(found[name])[:rows]), name
    for name in ("E_true_Pa", "F_true_N", "strain_true", "F_ref_N", "tau_load_cmd_Nm"):
        assert np.isnan(np.asarray(found[name])).all(), name
