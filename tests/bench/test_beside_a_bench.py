"""What may be done, and what not, on the bus of a bench that runs."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.bench.whole_runs import ENDLESS, bus_of, config, gone, run_folders, start, wait_for_frames
from tests.cli.in_process import hilbench

from hilbench.apps.scripts.bench import Bench
from hilbench.results.result import Result

pytestmark = pytest.mark.slow

EDS = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, subprocess.Popen[str]]]:
    """A bench that moves."""
    path = config(tmp_path_factory.mktemp("master"), steps=ENDLESS)
    process = start(path)
    wait_for_frames(path, 300)
    yield path, process
    assert process.poll() is None, "it was disturbed"
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    (folder,) = run_folders(path)  # nobody who was refused has made one
    assert [fault.source for fault in Result.read(folder / "result.json").faults] == ["operator"]
    assert gone(path)


def refused(done: subprocess.CompletedProcess[str], path: Path, process: subprocess.Popen[str]) -> None:
    assert done.returncode == 2, (done.stdout, done.stderr)
    (line,) = done.stderr.strip().splitlines()
    for text in (bus_of(path), "bench web_section_step", f"process {process.pid}", "since", "expected"):
        assert text in line


@pytest.mark.parametrize(
    "command",
    [
        ["run", "CONFIG", "--out", "OUT"],
        ["run", "CONFIG", "--out", "OUT", "--no-start"],
        ["run", "CONFIG", "--out", "OUT", "--force"],  # not beside one of ours
        ["replay", "TRACE", "--bus", "BUS"],
        ["sdo", "write", "1", "controlword", "0", "--bus", "BUS", "--eds", str(EDS)],
        ["sdo", "write", "axis1", "controlword", "0", "--config", "CONFIG"],
        ["drive", "1", "disable", "--bus", "BUS", "--eds", str(EDS)],
        ["drive", "axis1", "reset", "--config", "CONFIG"],
    ],
    ids=lambda words: " ".join(words[:3]),
)
def test_beside_a_running_bench_nobody_else_writes(
    running: tuple[Path, subprocess.Popen[str]], tmp_path: Path, command: list[str]
) -> None:
    path, process = running
    trace = tmp_path / "trace.log"
    trace.write_text("(0.000000) vcan0 181#0000\n(0.001000) vcan0 701#05\n")
    names = {"CONFIG": str(path), "OUT": str(tmp_path / "out"), "TRACE": str(trace), "BUS": bus_of(path)}
    refused(hilbench(*(names.get(word, word) for word in command)), path, process)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["simulate-hardware", "twin"])
def test_nodes_that_are_played_are_not_played_twice(running: tuple[Path, subprocess.Popen[str]], command: str) -> None:
    path, _ = running
    done = hilbench(command, path)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert bus_of(path) in line
    assert "expected nobody who plays node" in line


def test_a_script_is_refused_as_well(running: tuple[Path, subprocess.Popen[str]]) -> None:
    path, process = running
    with pytest.raises(Exception, match=f"process {process.pid}") as caught, Bench(path):
        pass
    assert getattr(caught.value, "exit_code", None) == 2


def test_who_only_looks_is_let_in_and_an_operator_may_write_to_the_bench(
    running: tuple[Path, subprocess.Popen[str]],
) -> None:
    path, process = running
    read = hilbench("sdo", "read", "axis1", "6041", "--config", path, "--json")
    assert json.loads(read.stdout)["object"] == "6041h:0", read.stderr
    seen = json.loads(hilbench("scan", "--config", path, "--listen", "0.2", "--json").stdout)
    assert seen["master_at_work"]
    assert f"process {process.pid}" in seen["master"]
    written = hilbench("sdo", "write", "bench", "2200:3", "9.0e9", "--config", path, "--json")
    assert written.returncode == 0, written.stderr
    assert json.loads(written.stdout)["value"] == pytest.approx(9.0e9)
    at_all_costs = hilbench("sdo", "write", "axis1", "6085h", "7161972", "--config", path, "--force")
    assert at_all_costs.returncode == 0, at_all_costs.stderr
