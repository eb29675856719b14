"""Node ids by LSS: drives that have none, on an embedded bus of their own, and who gives them theirs."""

from __future__ import annotations

import json
import subprocess
import sys
import uuid
from collections.abc import Iterator

import pytest
from tests.cli.drives import EDS
from tests.cli.in_process import hilbench


@pytest.fixture
def bus() -> Iterator[str]:
    """A bus with two drives that wait for a node id, serial numbers 7 and 8."""
    name = f"embedded:{uuid.uuid4().hex[:12]}"
    arguments = [str(EDS), "--lss", "--count", "2", "--serial", "7", "--bus", name]
    running = subprocess.Popen(
        [sys.executable, "-m", "hilbench", "simulate-drive", *arguments], stdout=subprocess.PIPE, text=True
    )
    assert running.stdout is not None
    assert [running.stdout.readline() for _ in range(2)] == [
        f"hilbench_servo, serial number {serial}: waits for a node id\n" for serial in (7, 8)
    ]
    yield name
    running.terminate()
    running.communicate(timeout=20)


def identity(serial: int) -> str:
    return f"0:402h:0x10000:{serial}"


@pytest.mark.slow
def test_drives_without_a_node_id_are_found_named_and_named_anew(bus: str) -> None:
    scanned = hilbench("scan", "--lss", "--json", "--listen", "0.1", "--bus", bus)
    assert [device["serial_number"] for device in json.loads(scanned.stdout)["without_node_id"]] == [7, 8]
    unclear = hilbench("lss", "assign", "5", "--bus", bus)
    assert unclear.returncode == 2
    assert "2 devices have no node id: 0h:402h:10000h:7h, 0h:402h:10000h:8h" in unclear.stderr
    named = hilbench("lss", "assign", "5", "--identity", identity(8), "--bus", bus)
    assert named.stdout == "node 5: device 0h/402h revision 10000h, serial number 8, no node id before; stored\n"
    the_other = hilbench("lss", "assign", "6", "--no-store", "--bus", bus)
    assert the_other.stdout.endswith("serial number 7, no node id before; not stored\n")
    again = hilbench("lss", "assign", "9", "--identity", identity(8), "--bit-rate", "500", "--bus", bus)
    assert again.stdout.endswith("serial number 8, node 5 before; stored\n")
    for node_id, serial in ((6, 7), (9, 8)):
        read = hilbench("sdo", "read", str(node_id), "1018:4", "--eds", str(EDS), "--bus", bus, "--json")
        assert json.loads(read.stdout)["value"] == serial
    assert hilbench("sdo", "read", "5", "1018:4", "--eds", str(EDS), "--bus", bus).returncode == 3


@pytest.mark.slow
def test_what_cannot_be_assigned_is_said_in_one_line(bus: str) -> None:
    nobody = hilbench("lss", "assign", "5", "--identity", identity(44), "--bus", bus)
    assert nobody.returncode == 3
    assert "LSS, device 0h:402h:10000h:2Ch: no answer" in nobody.stderr
    rate = hilbench("lss", "assign", "5", "--identity", identity(7), "--bit-rate", "333", "--bus", bus)
    assert rate.returncode == 2
    assert "333 kbit/s, expected one of 10, 20, 50, 125, 250, 500, 800, 1000" in rate.stderr
    wrong = hilbench("lss", "assign", "5", "--identity", "1:2:3", "--bus", bus)
    assert wrong.returncode == 2
    assert "'1:2:3', expected VENDOR:PRODUCT:REVISION:SERIAL" in wrong.stderr
    hilbench("lss", "assign", "5", "--identity", identity(7), "--bus", bus)
    used = hilbench("lss", "assign", "5", "--identity", identity(8), "--bus", bus)
    assert used.returncode == 2
    assert "node 5 answers already" in used.stderr
