"""canopen's LocalNode, a slave that is not ours, and hilbench as its master."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench, nobody_else

from canopen import LocalNode, Network
from hilbench.can.python_can import can

EDS = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"
BUS = "virtual:local-node"


@pytest.fixture
def node() -> Iterator[LocalNode]:
    with can.Bus(interface="virtual", channel="local-node") as bus:
        network = Network(bus)
        network.connect()
        local = LocalNode(5, str(EDS))
        network.add_node(local)
        local.nmt.state = "PRE-OPERATIONAL"
        local.nmt.start_heartbeat(100)
        with nobody_else():
            yield local
        local.nmt.stop_heartbeat()
        network.disconnect()


def test_it_is_found_read_written_and_configured(node: LocalNode, tmp_path: Path) -> None:
    found = json.loads(hilbench("scan", "--bus", BUS, "--listen", "0.3", "--json").stdout)["stations"]
    assert [(each["node_id"], each["name"], each["nmt_state"]) for each in found] == [
        (5, "hilbench servo", "PRE-OPERATIONAL")
    ]
    there = ("--bus", BUS, "--eds", EDS)
    assert hilbench("sdo", "write", "5", "6085", "4000", *there).returncode == 0
    assert node.sdo[0x6085].raw == 4000
    kept = tmp_path / "kept.dcf"
    assert hilbench("sdo", "dump", "5", kept, *there).returncode == 0
    node.sdo[0x6085].raw = 1
    differs = hilbench("sdo", "diff", "5", kept, *there)
    assert differs.returncode == 1
    assert "6085h" in differs.stdout
    loaded = hilbench("sdo", "load", "5", kept, *there)
    assert (loaded.returncode, node.sdo[0x6085].raw) == (0, 4000), loaded.stdout + loaded.stderr
    # Kept, a device is described by its DCF: no EDS file of it is needed any more.
    nowhere = tmp_path / "nowhere"
    nowhere.mkdir()
    assert hilbench("sdo", "diff", "5", kept, "--bus", BUS, "--eds", nowhere).returncode == 0
    node.sdo[0x6085].raw = 1
    assert hilbench("sdo", "load", "5", kept, "--bus", BUS, "--eds", nowhere).returncode == 0
    assert node.sdo[0x6085].raw == 4000
