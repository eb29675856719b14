"""`hilbench doctor` as a user starts it, on the embedded bus; and the page that says what it checks."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from tests.bench.whole_runs import SHORT, config, gone, start, wait_for_frames
from tests.cli.in_process import hilbench

from hilbench.apps.doctor import examination
from hilbench.apps.doctor.findings import Check

ROOT = Path(__file__).resolve().parents[2]


def doctor(*arguments: str) -> subprocess.CompletedProcess[str]:
    return hilbench("doctor", *arguments)


def findings(done: subprocess.CompletedProcess[str]) -> list[dict[str, Any]]:
    """Those of a --json run, checked against its own counts and exit code."""
    data = json.loads(done.stdout)
    levels = [finding["level"] for finding in data["findings"]]
    assert (data["errors"], data["warnings"]) == (levels.count("error"), levels.count("warning"))
    assert data["passed"] is (data["errors"] == 0) is (done.returncode == 0)
    assert data["timer_lateness"]["cycles"] > 0
    return list(data["findings"])


def of_check(found: list[dict[str, Any]], check: str) -> list[tuple[str, str]]:
    return [(finding["subject"], finding["level"]) for finding in found if finding["check"] == check]


def edited(path: Path, change: dict[str, Any]) -> Path:
    data = yaml.safe_load(path.read_text())
    for part, values in change.items():
        group = "load_motors" if part == "load" else "drives"
        data[group][part] |= values
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return path


@pytest.mark.slow
def test_a_simulated_bench_is_started_asked_and_ended(tmp_path: Path) -> None:
    path = config(tmp_path)
    done = doctor(str(path), "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found = findings(done)
    assert {finding["level"] for finding in found} == {"ok"}
    everybody = ["axis1 (node 1)", "axis2 (node 2)", "load (node 3)"]
    everybody += ["virtual axis1 (node 17)", "virtual axis2 (node 18)", "virtual io (node 32)"]
    for check in ("node_answers", "identity", "mapped_objects"):
        assert [subject for subject, _ in of_check(found, check)] == everybody
    assert any(finding["found"] == "embedded: nothing to check" for finding in found)
    assert gone(path)


@pytest.mark.slow
def test_a_real_drive_that_is_silent_and_one_that_its_eds_does_not_fit(tmp_path: Path) -> None:
    path = config(tmp_path, master={"boot_timeout_s": 20.0, "sdo_timeout_s": 0.3})
    eds = tmp_path / "other.eds"
    text = (ROOT / "eds" / "hilbench_servo.eds").read_text()
    eds.write_text(text.replace("ProductNumber=0x00000402", "ProductNumber=0x00000777").replace("0x00000402", "0x777"))
    edited(path, {"axis1": {"simulated": False}})
    # The simulated load motor is what its own EDS file says; the doctor is given another file for it.
    running = start_hardware(path)
    try:
        wait_for_node(path)
        edited(path, {"load": {"eds": str(eds)}})
        done = doctor(str(path), "--json", "--no-start")
        found = findings(done)
        assert done.returncode == 1
        assert ("axis1 (node 1)", "error") in of_check(found, "node_answers")
        assert ("axis2 (node 2)", "ok") in of_check(found, "node_answers")
        assert ("virtual io (node 32)", "error") in of_check(found, "node_answers")
        assert of_check(found, "identity") == [("axis2 (node 2)", "ok"), ("load (node 3)", "error")]
        shown = doctor(str(path), "--no-start")
        assert shown.returncode == 1
        assert "product code 00000402h" in shown.stdout
        assert "expected 00000777h" in shown.stdout
        assert "To do" in shown.stdout
    finally:
        running.send_signal(signal.SIGTERM)
        out, _ = running.communicate(timeout=30)
    assert out.splitlines()[-1] == "lost frames: 0"
    assert gone(path)


def start_hardware(path: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hilbench", "simulate-hardware", str(path), "--pace", "lockstep"]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def wait_for_node(path: Path) -> None:
    """Until the simulated axis 2 answers."""
    from hilbench.can.open import open_link
    from hilbench.canopen.listening import present
    from hilbench.runs.config import load

    link = open_link(load(path)[0].bus_address)
    try:
        assert any(present(link, [2], 0.2) for _ in range(200))
    finally:
        link.close()


@pytest.mark.slow
def test_a_running_bench_is_left_alone(tmp_path: Path) -> None:
    path = config(tmp_path, steps=[SHORT[0], {"hold": {"duration_s": 1000.0}}])
    bench = start(path)
    try:
        wait_for_frames(path, 500)
        found = findings(doctor(str(path), "--json"))
        assert [level for _, level in of_check(found, "other_master")] == ["error"]
        assert of_check(found, "node_answers") == []
        shown = " ".join(doctor(str(path)).stdout.split())  # the table breaks lines between words
        assert "no node was asked" in shown
        assert f"process {bench.pid}" in shown
        assert bench.poll() is None
    finally:
        os.killpg(bench.pid, signal.SIGINT)
        bench.communicate(timeout=60)
    assert bench.returncode == 130
    assert gone(path)


def test_an_interface_that_is_not_there_and_no_config() -> None:
    done = doctor("--bus", "socketcan:nocan99", "--json")
    found = findings(done)
    assert done.returncode == 1
    assert of_check(found, "interface") == [("nocan99", "error")]
    assert ("socketcan:nocan99", "warning") in of_check(found, "bus")


def test_an_examination_that_could_ask_nobody_does_not_say_that_all_is_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(examination, "_LISTEN_S", 0.1)  # there is nobody
    hub = f"embedded:{yaml.safe_load(config(tmp_path).read_text())['bus']['address'].partition(':')[2]}"
    done = doctor("--bus", hub)
    assert done.returncode == 0
    assert "no node was asked" in done.stdout
    assert "0 errors" not in done.stdout
    assert json.loads(doctor("--bus", hub, "--json").stdout)["nodes_asked"] == 0
    assert "no node was asked" in doctor().stdout  # this machine alone, whatever buses run


@pytest.mark.parametrize("arguments", [("--bus", "can0"), ("no_such_config.yaml",), ("--set", "seed=3")])
def test_unusable_input_is_exit_2_and_one_line(arguments: tuple[str, ...]) -> None:
    done = doctor(*arguments)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout == ""


def test_the_page_describes_exactly_what_is_checked() -> None:
    page = (ROOT / "docs" / "real_stand.md").read_text(encoding="utf-8")
    table = page.split("## What `hilbench doctor` checks")[1].split("\n## ")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE) == [str(check) for check in Check]
