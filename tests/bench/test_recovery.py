"""A bench that is killed in mid-run loses nothing but its last cycle or two: `hilbench recover`."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
from tests.bench.whole_runs import SHORT, config, gone, recover, run_folders, run_here, start, wait_for_frames

from hilbench.results.recording import read_recording
from hilbench.results.result import Result

#: Told to the drives in whole device units: 0.0001 rpm at the motor, at the web.
COMMANDED = ("v1_cmd_m_s", "v2_cmd_m_s")
RESOLUTION_M_S = 0.0001 / 60.0 * 2.0 * np.pi * 0.2 / 5.0


def test_a_killed_run_is_recovered_as_it_would_have_been_recorded(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[*SHORT[:3], {"hold": {"duration_s": 1.0}}])
    assert run_here(path, "--no-report")[0] == 0
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
    for name in whole.channels:
        one, two = np.asarray(whole[name])[:rows], np.asarray(found[name])[:rows]
        if name in COMMANDED:
            assert np.max(np.abs(one - two)) <= RESOLUTION_M_S, name
        else:
            assert np.array_equal(one, two), name
    result = Result.read(folder / "result.json")
    assert not result.passed
    assert "cut off" in result.faults[0].text
    assert "cut off" in (folder / "result.xml").read_text()
    assert "cut off" in (folder / "report.html").read_text()
    again = recover(folder)
    assert again.returncode == 2
    assert "there already" in again.stderr
