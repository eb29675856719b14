"""`hilbench simulate-drive` as a user starts it, on an embedded bus of its own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cia402.every_mode import INCREMENTS, eds_file
from tests.cli.in_process import hilbench, nobody_else

from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present

HILBENCH = [sys.executable, "-m", "hilbench"]


@pytest.fixture(scope="module")
def eds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return eds_file(tmp_path_factory.mktemp("eds"), 0x608F)


@pytest.fixture(scope="module")
def drives(eds: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Two drives, nodes 5 and 6, that are there: their bus and their process."""
    bus = f"embedded:{uuid.uuid4().hex[:12]}"
    behaviour = tmp_path_factory.mktemp("behaviour") / "slow.yaml"
    behaviour.write_text("units: {rated_torque_Nm: 2.0}\n")
    arguments = [str(eds), "--node", "5", "--count", "2", "--bus", bus, "--behaviour", str(behaviour)]
    running = subprocess.Popen([*HILBENCH, "simulate-drive", *arguments], stdout=subprocess.PIPE, text=True)
    link = open_link(BusAddress.parse(bus))
    assert any(len(present(link, [5, 6], 0.2)) == 2 for _ in range(300)), "the drives do not answer"
    link.close()
    with nobody_else():
        yield bus, running
    running.send_signal(signal.SIGINT)
    running.communicate(timeout=20)


def test_they_are_found_and_read_and_driven_by_hand(drives: tuple[str, subprocess.Popen[str]], eds: Path) -> None:
    bus, _ = drives
    there = ("--bus", bus, "--eds", eds)
    assert hilbench("sdo", "read", "6", "0x6041", *there).returncode == 0
    hilbench("sdo", "write", "5", "0x6060", "1", *there)
    for word in ("0x06", "0x07", "0x0F"):
        assert hilbench("sdo", "write", "5", "0x6040", word, *there).returncode == 0
    assert hilbench("sdo", "write", "5", "0x607A", str(INCREMENTS), *there).returncode == 0


def test_what_the_file_does_not_tell_is_said(drives: tuple[str, subprocess.Popen[str]]) -> None:
    assert drives[1].stdout is not None
    lines = [drives[1].stdout.readline() for _ in range(4)]
    assert lines[0].startswith("node 5: drive with every mode; profile position, velocity, profile velocity, torque")
    assert lines[1] == "node 5: 608Fh is absent or 0, and so is 6092h: 4096 position units a turn of the motor\n"
    assert lines[2].startswith("node 6: ")


def test_a_node_that_is_there_is_not_played_twice(drives: tuple[str, subprocess.Popen[str]], eds: Path) -> None:
    done = hilbench("simulate-drive", eds, "--node", "6", "--bus", drives[0])
    assert done.returncode == 2
    assert "node 6" in str(done.stderr)


@pytest.mark.slow
def test_a_hundred_drives_on_a_bus_are_all_found_and_each_can_be_driven() -> None:
    bus, eds = f"embedded:{uuid.uuid4().hex[:12]}", Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"
    command = [*HILBENCH, "simulate-drive", eds, "--count", "100", "--bus", bus]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        link = open_link(BusAddress.parse(bus))
        assert any(len(present(link, range(1, 101), 1.0)) == 100 for _ in range(60)), "not all of them answer"
        link.close()
        found = json.loads(hilbench("scan", "--bus", bus, "--json").stdout)["stations"]
        assert [station["node_id"] for station in found] == list(range(1, 101))
        with nobody_else():
            for node in (1, 100):
                turned = hilbench("drive", node, "velocity", "60 rpm", "--for", "0.3", "--bus", bus, "--eds", eds)
                assert turned.returncode == 0, turned.stderr
    finally:
        running.send_signal(signal.SIGINT)
        running.wait(timeout=20)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--node", "127", "--count", "2"), "2 drives from node 127 on, expected ids up to 127"),
        (("--plant", "bench_configs/web_section_step.yaml"), "the machine is a web_line, expected a servo_axis"),
        (("--behaviour", "nowhere.yaml"), "nowhere.yaml"),
        (("--bus", "nothing:x"), "found interface 'nothing'"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(eds: Path, arguments: tuple[str, ...], said: str) -> None:
    done = hilbench(
        "simulate-drive", eds, *(("--bus", "embedded:none") if "--bus" not in arguments else ()), *arguments
    )
    assert done.returncode == 2
    assert said in str(done.stderr)
    assert len(str(done.stderr).strip().splitlines()) == 1
