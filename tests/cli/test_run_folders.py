"""What is done with run folders afterwards, as a user does it: two short runs, compared, replayed, read by a CI."""

from __future__ import annotations

import json
import subprocess
import sys
import uuid
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.bench.test_runs import SHORT, config, run, run_folders

from hilbench.record.recording import read_recording

HILBENCH = [sys.executable, "-m", "hilbench.cli"]
CRITERIA = [
    {"name": "far from its bound", "metric": "cycles_missed", "max": 5, "margin": 1},
    {"name": "close to its bound", "metric": "cycles_missed", "max": 5, "margin": 10},
    {"name": "beyond its bound", "metric": "bus_load_pct", "max": 1},
    {"name": "without a value", "metric": "jitter_max_us", "max": 1},
]


def hilbench(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*HILBENCH, *map(str, arguments)], capture_output=True, text=True, timeout=90, check=False)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    path = config(tmp_path_factory.mktemp("runs"), steps=SHORT[:-1], criteria=CRITERIA)
    assert run(path)[0] == 1
    assert run(path, "--set", "tension_control.set_point_N=90")[0] == 1
    return run_folders(path)


def test_a_ci_sees_passed_failed_and_error_apart(runs: list[Path]) -> None:
    suite = ElementTree.parse(runs[0] / "result.xml").getroot()
    assert {key: suite.get(key) for key in ("tests", "failures", "errors")} == {
        "tests": "5",
        "failures": "1",
        "errors": "1",
    }
    kinds = {case.get("name"): case[0].tag if len(case) else None for case in suite}
    assert kinds == {
        "far from its bound": "system-out",
        "close to its bound": "system-out",
        "beyond its bound": "failure",
        "without a value": "error",
        "the run ends without a fault": None,
    }
    criteria = json.loads((runs[0] / "result.json").read_text())["criteria"]
    assert [row.get("marginal", False) for row in criteria] == [False, True, False, False]
    page = (runs[0] / "report.html").read_text()
    assert [page.count(f'class="result {word}"') for word in ("passed", "marginal", "failed", "error")] == [1, 1, 1, 1]


def test_compare_says_what_differs(runs: list[Path], tmp_path: Path) -> None:
    done = hilbench("compare", *runs, "--out", tmp_path / "compare.html", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    assert [entry["passed"] for entry in data["runs"]] == [False, False]
    rows = {row["metric"]: row for row in data["metrics"]}
    first, second = rows["tension_final_error_N"]["values"]
    assert rows["tension_final_error_N"]["differences"] == [second - first]
    assert rows["E_time_to_1pct_s"]["unit"] == "s"
    assert (tmp_path / "compare.html").read_text().count("<svg") == 4
    assert hilbench("compare", runs[0]).returncode == 2


def test_the_twin_over_a_recording_finds_what_it_found_on_the_bus(runs: list[Path], tmp_path: Path) -> None:
    done = hilbench("replay", runs[0], "--twin", "--out", tmp_path / "again.csv", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    recorded, again = read_recording(runs[0] / "recording.mf4"), read_recording(tmp_path / "again.csv")
    assert data["cycles"] == len(recorded) == len(again)
    assert again["E_sim_Pa"][-1] == pytest.approx(recorded["E_sim_Pa"][-1], rel=2e-3)
    assert recorded["E_sim_Pa"][-1] == pytest.approx(10.5e9, rel=1e-2)


def test_a_trace_goes_back_onto_a_bus_without_what_moves_drives(runs: list[Path]) -> None:
    bus = f"embedded:t{uuid.uuid4().hex[:10]}"
    done = hilbench("replay", runs[0], "--bus", bus, "--speed", "50", "--json")
    assert done.returncode == 0, done.stderr
    data = json.loads(done.stdout)
    lines = (runs[0] / "trace.log").read_text().splitlines()
    identifiers = [int(line.split()[2].partition("#")[0], 16) for line in lines]
    told = [
        number for number in identifiers if number & 0x780 in (0, 0x200, 0x300, 0x400, 0x500, 0x600) or number == 0x80
    ]
    assert (data["frames"], data["left_out"]) == (len(identifiers) - len(told), len(told))
    assert 0 < data["left_out"] < data["frames"]
