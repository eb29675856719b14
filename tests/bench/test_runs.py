"""Whole runs as a user starts them: real processes on the embedded bus, in lockstep."""

from __future__ import annotations

import json
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.bench.whole_runs import (
    ENDLESS,
    config,
    frames_by_cycle,
    gone,
    pid_of,
    processes_of,
    run,
    run_folders,
    run_here,
    start,
    wait_for_frames,
)

from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import UnusableInputError
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides


@pytest.mark.slow
def test_one_seed_gives_one_recording_and_the_same_frames_in_every_cycle(tmp_path):
    path = config(tmp_path)
    assert [again(path)[0] for again in (run, run, run_here)] == [0, 0, 0]
    first, *others = run_folders(path)
    one = read_recording(first / "recording.mf4")
    assert len(one) > 1000
    assert np.ptp(np.asarray(one["E_true_Pa"])) > 1e9
    assert len(others) == 2
    for second in others:
        other = read_recording(second / "recording.mf4")
        assert list(one.channels) == list(other.channels)
        for name in one.channels:
            assert np.array_equal(one[name], other[name]), name
        # The last SYNC's frames end with the run; after it the nodes are told to leave OPERATIONAL.
        assert frames_by_cycle(first / "trace.log")[:-1] == frames_by_cycle(second / "trace.log")[:-1]
    assert gone(path)


def test_in_one_process_real_time_is_lockstep_by_the_clock(tmp_path):
    path = config(tmp_path, steps=[{"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 1.0}}], criteria=[])
    assert run_here(path)[0] == run_here(path, "--pace", "realtime")[0] == 0
    lockstep, by_clock = run_folders(path)
    one, other = (read_recording(folder / "recording.mf4") for folder in (lockstep, by_clock))
    for name in one.channels:
        assert np.array_equal(one[name], other[name]), name
    timing = json.loads((by_clock / "result.json").read_text())["timing"]
    assert (timing["pace"], len(timing["late"])) == ("realtime", 0)
    assert timing["realtime_factor"] < 1.01, "no SYNC before its time"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"bus": {"address": "socketcan:vcan0"}}, "found bus socketcan:vcan0, expected the embedded bus"),
    ],
)
def test_what_cannot_run_in_process_is_said_before_anything_is_made(tmp_path, change, said):
    loaded = load_with_overrides(config(tmp_path, **change))
    with pytest.raises(UnusableInputError, match=said):
        run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_listening_and_copying_give_the_same_estimate_and_another_seed_another(tmp_path):
    curves = []
    for number, changes in enumerate(({}, {"mirroring": "copy"}, {"seed": 2})):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = config(folder, **changes)
        assert run_here(path)[0] == 0
        curves.append(np.asarray(read_recording(run_folders(path)[0] / "recording.mf4")["E_sim_Pa"]))
    assert np.array_equal(curves[0], curves[1])
    assert not np.array_equal(curves[0], curves[2])


def test_the_length_of_a_run_is_one_number_in_recording_result_and_junit(tmp_path):
    path = config(tmp_path)
    assert run_here(path, report=True)[0] == 0
    (folder,) = run_folders(path)
    recorded = len(read_recording(folder / "recording.mf4"))
    timing = json.loads((folder / "result.json").read_text())["timing"]
    assert timing["cycles"] == recorded
    assert f'time="{recorded * 0.002:.3f}"' in (folder / "result.xml").read_text()
    cycles = re.findall(r"(\d+) cycles of 2 ms|cycles</t[hd]>\s*<td[^>]*>(\d+)<", (folder / "report.html").read_text())
    assert {number for found in cycles for number in found if number} == {str(recorded)}


def test_a_failed_criterion_is_exit_1_and_json_is_one_object(tmp_path):
    criterion = {"name": "impossible", "metric": "E_final_error_pct", "max": 0.0}
    code, out, _ = run_here(config(tmp_path, criteria=[criterion]), "--json")
    result = json.loads(out)
    assert code == 1
    assert result["passed"] is False
    assert result["timing"]["pace"] == "lockstep"
    assert [row["name"] for row in result["criteria"]] == ["impossible"]


@pytest.mark.slow
def test_an_effect_hidden_by_a_step_in_the_hardware_shows_in_the_torque(tmp_path):
    steps = [
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
        {"hold": {"until_s": 2.0}},
        {"step": {"path": "hardware.effects.coulomb_friction.axis1.force_N", "to": 20.0}},
        {"hold": {"duration_s": 2.0}},
    ]
    path = config(tmp_path, steps=steps)
    assert run_here(path)[0] == 0
    recording = read_recording(run_folders(path)[0] / "recording.mf4")
    t_s, torque = recording.time_s, np.asarray(recording["tau1_Nm"])
    before, after = torque[(t_s > 1.5) & (t_s < 2.0)].mean(), torque[t_s > 3.5].mean()
    assert after - before == pytest.approx(20.0 * 0.2 / 5.0, abs=0.05)  # F·r/i


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, r"bench.yaml:\d+: unknown key 'colour'"),
        ({"cycle_time_s": -0.002}, r"bench.yaml:\d+: 'cycle_time_s' is -0.002, expected: .*0.0005"),
        ({"pace": "fast"}, r"bench.yaml:\d+: 'pace' is 'fast', expected: .*'lockstep' or 'realtime'"),
        ({"steps": [{"set": {"path": "line_sped", "to": 1.0}}]}, r"bench.yaml:\d+: .*'line_sped', expected: one of"),
        ({"load": {"effects": [{"effect": "gremlins", "parameters": {}}]}}, r"bench.yaml:\d+: .*gremlins"),
        ({"cycle_time_s": 0.001}, r"bench.yaml:\d+: the PDO set takes 1\d\d\d bit times of the 1000"),
    ],
)
def test_a_wrong_config_is_exit_2_and_one_line(tmp_path, change, message):
    path = config(tmp_path, **change)
    code, _, err = run_here(path)
    assert code == 2
    assert len(err.strip().splitlines()) == 1
    assert re.search(message, err), err
    assert not run_folders(path)
    assert not processes_of(path)


def test_two_nodes_with_one_id_are_named(tmp_path):
    path = config(tmp_path)
    data = yaml.safe_load(path.read_text())
    data["load_motors"]["load"]["node_id"] = 2
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    code, _, err = run_here(path)
    assert code == 2
    assert "axis2 and load both have 2" in err


def test_an_eds_without_a_mapped_object_is_named_with_its_line(tmp_path):
    path = config(tmp_path)
    data = yaml.safe_load(path.read_text())
    eds = tmp_path / "no_target.eds"
    text = Path(data["drives"]["axis1"]["eds"]).read_text().replace("[60FF]", "[5FFF]")
    eds.write_text(text)
    data["drives"]["axis1"]["eds"] = str(eds)
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    code, _, err = run_here(path)
    assert code == 2
    assert "60FFh" in err
    assert "bench.yaml:" in err


@pytest.mark.slow
def test_a_silent_node_is_named_with_what_was_tried(tmp_path):
    path = config(tmp_path, master={"boot_timeout_s": 2.0})
    data = yaml.safe_load(path.read_text())
    data["drives"]["axis1"]["simulated"] = False
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    code, out, _ = run(path)
    assert code == 3
    assert "no answer from axis1 (node 1)" in out
    assert "1000h" in out
    assert gone(path)


@pytest.mark.slow
def test_ctrl_c_stops_the_drives_and_keeps_the_recording(tmp_path):
    path = config(tmp_path, steps=ENDLESS)
    process = start(path, report=True)
    folder = wait_for_frames(path, 500)
    os.killpg(process.pid, signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted" in out
    assert len(read_recording(folder / "recording.mf4")) > 100
    assert (folder / "report.html").exists()
    controlwords = [
        line.split("#")[1][:4] for line in (folder / "trace.log").read_text().splitlines() if " 201#" in line
    ]
    assert controlwords[-1] == "0200"  # quick stop was the last that axis 1 was told
    assert gone(path)


@pytest.mark.slow
def test_hardware_that_is_killed_ends_the_run_with_exit_3(tmp_path):
    path = config(tmp_path, steps=ENDLESS, safety={"cycle_timeout_s": 1.0})
    process = start(path)
    folder = wait_for_frames(path, 500)
    os.kill(pid_of(path, "hardware"), signal.SIGKILL)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "no answer to SYNC from axis1" in out.replace("\n", " ")
    assert len(read_recording(folder / "recording.mf4")) > 100
    assert gone(path)
