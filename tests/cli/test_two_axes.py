"""`simulate-drive`, `scan`, `drive` and `sdo` with a node of two axes."""

from __future__ import annotations

import json
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from tests.cli.in_process import hilbench, nobody_else

from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present

ROOT = Path(__file__).parents[2]
DUAL = ROOT / "eds" / "hilbench_servo_dual.eds"


@pytest.fixture(scope="module")
def played() -> Iterator[tuple[str, list[str]]]:
    """The bus with the node, which has id 1, and what its program said."""
    bus = f"embedded:{uuid.uuid4().hex[:12]}"
    command = [sys.executable, "-m", "hilbench", "simulate-drive", str(DUAL), "--node", "1", "--bus", bus]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert running.stdout is not None
    said = [running.stdout.readline() for _ in range(2)]
    link = open_link(BusAddress.parse(bus))
    assert any(present(link, [1], 0.2) for _ in range(300)), "the drive does not answer"
    link.close()
    with nobody_else():
        yield bus, said
    running.terminate()
    running.wait(timeout=20)


def test_both_axes_are_introduced(played: tuple[str, list[str]]) -> None:
    assert [line.partition(":")[0] for line in played[1]] == ["node 1", "node 1, axis 2"]


def test_drive_moves_the_axis_that_is_asked_for(played: tuple[str, list[str]]) -> None:
    there = ("--bus", played[0], "--eds", DUAL)
    done = hilbench("drive", "1", "velocity", "60 rpm", "--for", "0.5", "--axis", "2", "--json", *there)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["position_rad"] > 1.0
    first = json.loads(hilbench("drive", "1", "status", "--json", *there).stdout)
    assert (first["position_rad"], first["state"]) == (0.0, "SWITCH ON DISABLED")
    read = hilbench("sdo", "read", "1", "6864h", *there)
    assert (read.returncode, "rad" in read.stdout) == (0, True)


def test_drive_says_what_an_axis_cannot_do_by_its_own_objects(played: tuple[str, list[str]]) -> None:
    done = hilbench("drive", "1", "status", "--axis", "2", "--bus", played[0], "--eds", DUAL)
    assert "profile position can't be used: 6D02h is " in done.stdout
    done = hilbench("drive", "1", "status", "--axis", "3", "--bus", played[0], "--eds", DUAL)
    assert done.returncode == 2
    assert "--axis: 3, expected one that the EDS file of node 1 has: 1, 2" in done.stderr


def test_drive_knows_the_axes_of_a_config_by_their_names(played: tuple[str, list[str]], tmp_path: Path) -> None:
    data = yaml.safe_load((ROOT / "bench_configs" / "web_section_dual_axis.yaml").read_text())
    drives = data["drives"].values()
    for node in (*drives, *(d["virtual"] for d in drives), *data["load_motors"].values(), data["twin"]["node"]):
        node["eds"] = str((ROOT / "bench_configs" / node["eds"]).resolve())
    config = tmp_path / "bench.yaml"
    config.write_text(yaml.safe_dump(data, sort_keys=False))
    there = ("--bus", played[0], "--config", config)
    for node in (("axis2",), ("1", "--axis", "2")):
        done = hilbench("drive", node[0], "status", *node[1:], *there)
        assert (done.returncode, done.stderr) == (0, "")
        assert "6D02h" in done.stdout
    done = hilbench("drive", "axis1", "status", "--axis", "2", *there)
    assert (done.returncode, "--axis: 2, expected none with axis1, which is axis 1" in done.stderr) == (2, True)
    found = json.loads(hilbench("scan", "--json", *there).stdout)
    assert [station["part"] for station in found["stations"]] == ["axis1, axis2"]


def test_scan_shows_the_state_of_both(played: tuple[str, list[str]]) -> None:
    done = hilbench("scan", "--json", "--bus", played[0], "--eds", DUAL.parent)
    (station,) = json.loads(done.stdout)["stations"]
    assert station["drive_state"] == "SWITCH ON DISABLED, SWITCH ON DISABLED"
    assert (station["device_type"], Path(station["eds"]).name) == (0xFFFF_0192, DUAL.name)
