"""Whole runs as a user starts them: real processes on the embedded bus, in lockstep."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import UnusableInputError
from hilbench.results.recording import read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "bench_configs" / "web_section_step.yaml"
SHORT = [
    {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
    {"hold": {"until_s": 0.6}},
    {"step": {"path": "load.web.youngs_modulus_Pa", "to": 10.5e9}},
    {"hold": {"duration_s": 1.2}},
    {"ramp": {"path": "line_speed_m_s", "to": 0.0, "duration_s": 0.4}},
]


def config(folder: Path, **changes: object) -> Path:
    data = yaml.safe_load(SHIPPED.read_text(encoding="utf-8"))
    drives = data["drives"].values()
    nodes = [*drives, *(drive["virtual"] for drive in drives), *data["load_motors"].values(), data["twin"]["node"]]
    for node in nodes:
        node["eds"] = str((SHIPPED.parent / node["eds"]).resolve())
    data["machine"]["web"] |= {"youngs_modulus_Pa": 8.7e9, "thickness_m": 65e-6}
    data["steps"], data["criteria"] = SHORT, []
    data["bus"]["address"] = f"embedded:t{uuid.uuid4().hex[:10]}"
    changes["twin"] = data["twin"] | changes.get("twin", {})  # type: ignore[operator]
    data |= changes
    path = folder / "bench.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def start(path: Path, *options: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hilbench.cli", "run", str(path), "--out", str(path.parent / "runs"), *options]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)


def run(path: Path, *options: str) -> tuple[int, str, str]:
    process = start(path, *options)
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def run_folders(path: Path) -> list[Path]:
    folders = path.parent / "runs"
    return sorted(folders.iterdir()) if folders.exists() else []


def processes_of(path: Path) -> list[str]:
    """Command lines of the processes that a run of this config started (children by path, hub by channel)."""
    channel = yaml.safe_load(path.read_text())["bus"]["address"].partition(":")[2]
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(str(path.parent).encode() in word or channel.encode() in word for word in words):
                found.append(b" ".join(words).decode())
    return found


def gone(path: Path, within_s: float = 15.0) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if not processes_of(path):
            return True
        time.sleep(0.1)
    return False


def frames_by_cycle(trace: Path) -> list[Counter[str]]:
    cycles: list[Counter[str]] = []
    for line in trace.read_text().splitlines():
        frame = line.split()[2]
        if frame == "080#":
            cycles.append(Counter())
        elif cycles:
            cycles[-1][frame] += 1
    return cycles


def wait_for_frames(path: Path, count: int, within_s: float = 60.0) -> Path:
    """The run folder, once its trace has so many lines."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        for folder in run_folders(path):
            trace = folder / "trace.log"
            if trace.exists() and trace.read_bytes().count(b" 080#") >= count:
                return folder
        time.sleep(0.05)
    raise AssertionError("the run did not get so far")


def test_one_seed_gives_one_recording_and_the_same_frames_in_every_cycle(tmp_path):
    path = config(tmp_path)
    assert [run(path)[0], run(path)[0], run(path, "--in-process", "--no-report")[0]] == [0, 0, 0]
    first, second, in_process = run_folders(path)
    one = read_recording(first / "recording.mf4")
    for folder in (second, in_process):
        other = read_recording(folder / "recording.mf4")
        assert list(one.channels) == list(other.channels)
        for name in one.channels:
            assert np.array_equal(one[name], other[name]), name
    assert len(one) > 1000
    assert np.ptp(np.asarray(one["E_true_Pa"])) > 1e9
    # The last SYNC's frames end with the run; after it the nodes are told to leave OPERATIONAL.
    frames = frames_by_cycle(first / "trace.log")[:-1]
    assert frames == frames_by_cycle(second / "trace.log")[:-1]
    assert frames == frames_by_cycle(in_process / "trace.log")[:-1]
    assert gone(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"pace": "realtime"}, "found pace realtime, expected lockstep"),
        ({"bus": {"address": "socketcan:vcan0"}}, "found bus socketcan:vcan0, expected the embedded bus"),
    ],
)
def test_what_cannot_run_in_process_is_said_before_anything_is_made(tmp_path, change, said):
    loaded = load_with_overrides(config(tmp_path, **change))
    with pytest.raises(UnusableInputError, match=said):
        run_experiment(loaded, tmp_path / "runs", participants=Participants.IN_PROCESS)
    assert not (tmp_path / "runs").exists()


def test_listening_and_copying_give_the_same_estimate_and_another_seed_another(tmp_path):
    curves = []
    for number, changes in enumerate(({}, {"mirroring": "copy"}, {"seed": 2})):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = config(folder, **changes)
        assert run(path, "--in-process", "--no-report")[0] == 0
        curves.append(np.asarray(read_recording(run_folders(path)[0] / "recording.mf4")["E_sim_Pa"]))
    assert np.array_equal(curves[0], curves[1])
    assert not np.array_equal(curves[0], curves[2])


def test_a_failed_criterion_is_exit_1_and_json_is_one_object(tmp_path):
    criterion = {"name": "impossible", "metric": "E_final_error_pct", "max": 0.0}
    code, out, _ = run(config(tmp_path, criteria=[criterion]), "--json")
    result = json.loads(out)
    assert code == 1
    assert result["passed"] is False
    assert result["timing"]["pace"] == "lockstep"
    assert [row["name"] for row in result["criteria"]] == ["impossible"]


def test_an_effect_hidden_by_a_step_in_the_hardware_shows_in_the_torque(tmp_path):
    steps = [
        {"ramp": {"path": "line_speed_m_s", "to": 1.0, "duration_s": 0.4}},
        {"hold": {"until_s": 2.0}},
        {"step": {"path": "hardware.effects.coulomb_friction.axis1.force_N", "to": 20.0}},
        {"hold": {"duration_s": 2.0}},
    ]
    path = config(tmp_path, steps=steps)
    assert run(path)[0] == 0
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
    code, _, err = run(path)
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
    code, _, err = run(path)
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
    code, _, err = run(path)
    assert code == 2
    assert "60FFh" in err
    assert "bench.yaml:" in err


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


def test_ctrl_c_stops_the_drives_and_keeps_the_recording(tmp_path):
    path = config(tmp_path, steps=[SHORT[0], {"hold": {"duration_s": 1000.0}}])
    process = start(path)
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


def test_hardware_that_is_killed_ends_the_run_with_exit_3(tmp_path):
    steps = [SHORT[0], {"hold": {"duration_s": 1000.0}}]
    path = config(tmp_path, steps=steps, safety={"cycle_timeout_s": 1.0})
    process = start(path)
    folder = wait_for_frames(path, 500)
    subprocess.run(["pkill", "-KILL", "-f", f"hilbench.hardware {folder}"], check=True)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 3
    assert "no answer to SYNC from axis1" in out.replace("\n", " ")
    assert len(read_recording(folder / "recording.mf4")) > 100
    assert gone(path)
