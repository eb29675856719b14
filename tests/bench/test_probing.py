"""The bench asks the machine by a small change of the tension, and then knows E."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import config, run_folders, run_here

from hilbench.results.journal import read_journal
from hilbench.results.recording import Recording, read_recording
from hilbench.topology.web_line_quantities import TENSION_PROBE

RAMP = {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}}
WANTED = {"set": {"path": TENSION_PROBE, "to": 1}}
REFUSED = {"set": {"path": TENSION_PROBE, "to": 0}}


def hold(duration_s: float) -> dict[str, object]:
    return {"hold": {"duration_s": duration_s}}


def ran(
    tmp_path: Path, steps: list[object], probing: object, friction_N: float = 10.0
) -> tuple[Recording, list[tuple[str, float]], str]:
    """The recording, what the journal has of probes, and what was said."""
    path = config(
        tmp_path,
        steps=[*steps, {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 1.0}}],
        controllers={"tension_control": {"set_point_N": 80.0, "probing": probing}},
        hardware={"effects": [{"effect": "coulomb_friction", "axis": 2, "parameters": {"force_N": friction_N}}]},
    )
    code, said, errors = run_here(path)
    assert code == 0, errors
    folder = run_folders(path)[0]
    journal = [(each.path, each.value) for each in read_journal(folder / "journal.log") if each.path == TENSION_PROBE]
    return read_recording(folder / "recording.mf4"), journal, said + errors


def shifted(recording: Recording) -> np.ndarray:
    return np.asarray(np.flatnonzero(np.asarray(recording["F_ref_N"]) != 80.0))


def error_at(recording: Recording, t_s: float) -> float:
    row = int(np.searchsorted(recording.time_s, t_s))
    return float(recording["E_sim_Pa"][row] / recording["E_true_Pa"][row] - 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("friction_N", [5.0, 20.0])
def test_a_probe_tells_E_from_hidden_friction_within_five_seconds(tmp_path: Path, friction_N: float) -> None:
    recording, journal, said = ran(tmp_path, [RAMP, hold(8.5)], "on", friction_N)
    probe = shifted(recording)
    begun_s = recording.time_s[probe[0]]
    assert np.ptp(recording.time_s[probe]) <= 5.0
    assert np.max(np.abs(np.asarray(recording["F_ref_N"]) / 80.0 - 1.0)) <= 0.02 + 1e-9
    assert abs(error_at(recording, begun_s - 0.1)) > 0.04
    assert abs(error_at(recording, begun_s + 5.0)) <= 0.003
    assert journal == [(TENSION_PROBE, 1.0), (TENSION_PROBE, 0.0)]
    assert "tension set-point ±1.6 N for 5 s" in said


@pytest.mark.slow
def test_off_is_off(tmp_path: Path) -> None:
    recording, journal, said = ran(tmp_path, [RAMP, hold(2.5), WANTED, hold(1.0)], "off")
    assert len(shifted(recording)) == 0
    assert journal == [(TENSION_PROBE, 1.0)]  # that somebody wanted it
    assert "'probing' is off in the config" in said


@pytest.mark.slow
def test_an_operator_is_asked_and_allows_it(tmp_path: Path) -> None:
    recording, journal, said = ran(tmp_path, [RAMP, hold(4.0), WANTED, hold(4.0)], "ask")
    assert "wanted" in said
    probe = shifted(recording)
    assert recording.time_s[probe[0]] >= 5.0
    assert [value for _, value in journal] == [1.0, 1.0, 0.0]  # allowed, begun, ended
    assert abs(error_at(recording, recording.time_s[probe[0]] + 3.0)) <= 0.003


def test_an_operator_is_asked_and_refuses(tmp_path: Path) -> None:
    recording, _, said = ran(tmp_path, [RAMP, hold(4.0), REFUSED, hold(2.0)], "ask")
    assert "refused" in said
    assert len(set(re.findall(r"t = (\S+) s\S? probe: wanted", said))) == 1  # asked once
    assert len(shifted(recording)) == 0


def test_a_probe_is_broken_off_when_the_line_changes_its_speed(tmp_path: Path) -> None:
    steps = [RAMP, hold(2.5), {"ramp": {"path": "line_speed_m_s", "to": 2.5, "duration_s": 0.3}}, hold(0.5)]
    recording, journal, said = ran(tmp_path, steps, {"mode": "on", "deviation_pct": 0.01})
    probe = shifted(recording)
    assert recording.time_s[probe[-1]] <= 3.6
    assert "broken off" in said
    assert [value for _, value in journal] == [1.0, 0.0]
