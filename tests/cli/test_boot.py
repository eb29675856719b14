"""`hilbench boot` with networks that Lely's dcfgen describes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.cli.drives import EDS, bus, sdo
from tests.cli.in_process import hilbench

__all__ = ["bus"]

NODE = """
{name}:
  dcf: {eds}
  node_id: {node_id}
  mandatory: {mandatory}
  heartbeat_producer: 100
  heartbeat_consumer: true
  sdo: [{{index: 0x6085, sub_index: 0, value: {value}}}]
"""

Network = Callable[..., Path]


@pytest.fixture
def network(tmp_path: Path) -> Network:
    """The master's DCF, with concise DCFs beside it, of nodes (id, mandatory, 6085h)."""

    def generate(*nodes: tuple[int, bool, int]) -> Path:
        text = "master: {node_id: 1}\n" + "".join(
            NODE.format(name=f"n{i}", eds=EDS, node_id=i, mandatory=str(m).lower(), value=v) for i, m, v in nodes
        )
        (tmp_path / "bus.yml").write_text(text)
        command = [str(Path(sys.executable).with_name("dcfgen")), "-r", "bus.yml"]
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
        return tmp_path / "master.dcf"

    return generate


def booted(file: Path, bus: str, *more: str) -> tuple[int, dict[int, str | None], bool]:
    """Exit code, error status by node, whether nodes were started."""
    done = hilbench("boot", str(file), "--json", "--bus", bus, *more)
    told = json.loads(done.stdout)
    return done.returncode, {node["node"]: node["error_status"] for node in told["nodes"]}, told["started"]


def states(bus: str) -> dict[int, str]:
    found = json.loads(hilbench("scan", "--json", "--listen", "0.5", "--bus", bus).stdout)
    return {station["node_id"]: station["nmt_state"] for station in found["stations"]}


def test_a_network_is_configured_and_started(bus: str, network: Network) -> None:
    assert booted(network((5, True, 5500), (6, False, 6600)), bus) == (0, {5: None, 6: None}, True)
    assert "5500" in sdo(bus, "read", 5, "6085").stdout
    assert "6600" in sdo(bus, "read", 6, "6085").stdout
    assert states(bus) == {5: "OPERATIONAL", 6: "OPERATIONAL"}


def test_without_an_optional_node_the_others_start(bus: str, network: Network) -> None:
    file = network((5, True, 5500), (7, False, 7700))
    assert booted(file, bus, "--timeout", "0.5") == (1, {5: None, 7: "B"}, True)
    assert states(bus)[5] == "OPERATIONAL"


@pytest.mark.slow
def test_without_a_mandatory_one_none_does(bus: str, network: Network) -> None:
    file = network((5, False, 5500), (7, True, 7700))
    assert booted(file, bus, "--timeout", "0.5") == (3, {5: None, 7: "B"}, False)
    assert states(bus)[5] == "PRE-OPERATIONAL"


@pytest.mark.parametrize(("index", "status"), [("1F84", "C"), ("1F86", "M")])
def test_another_device_than_expected_is_told_by_its_error_status(
    bus: str, network: Network, index: str, status: str
) -> None:
    file = network((5, True, 5500))
    text = re.sub(rf"(\[{index}Value\]\nNrOfEntries=1\n5=0x)\w+", r"\g<1>12345678", file.read_text())
    file.write_text(text)
    assert booted(file, bus) == (3, {5: status}, False)


def test_a_configuration_that_a_node_refuses_is_told_with_the_object(bus: str, network: Network) -> None:
    file = network((5, True, 5500))
    block = file.with_name("n5.bin")
    block.write_bytes(block.read_bytes().replace(b"\x85\x60", b"\x41\x60"))
    done = hilbench("boot", str(file), "--bus", bus)
    assert done.returncode == 3
    assert "node 5 (mandatory): error status J: 6041h sub 0: " in done.stdout
    assert "no node was started" in done.stdout


def test_a_file_of_no_master_is_refused_in_one_line(bus: str, tmp_path: Path, network: Network) -> None:
    done = hilbench("boot", str(EDS), "--bus", bus)
    assert done.returncode == 2
    assert "1F80h is 0h, expected that of an NMT master (bit 0)" in done.stderr
    file = network((5, True, 5500))
    file.with_name("n5.bin").unlink()
    done = hilbench("boot", str(file), "--bus", bus)
    assert done.returncode == 2
    assert "n5.bin: cannot be read" in done.stderr
