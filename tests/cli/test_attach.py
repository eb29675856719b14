"""`hilbench scan`, `sdo` and `drive` as a user starts them, on simulated hardware that nobody else uses."""

from __future__ import annotations

import json
import math
import os
import pty
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from tests.bench.whole_runs import config
from tests.cli.in_process import hilbench, nobody_else

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present, receive_for
from hilbench.runs.config import load

EDS = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"
HILBENCH = [sys.executable, "-m", "hilbench"]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The config of a bench whose simulated hardware runs."""
    path = config(tmp_path_factory.mktemp("attach"), pace="realtime")
    running = subprocess.Popen([*HILBENCH, "simulate-hardware", str(path)], stdout=subprocess.PIPE)
    link = open_link(load(path)[0].bus_address)
    assert any(present(link, [1], 0.2) for _ in range(300)), "the simulated hardware does not answer"
    link.close()
    with nobody_else():
        yield path
    running.terminate()
    running.communicate(timeout=20)


def attached(bench: Path) -> list[str]:
    """Without the config: the bus, and the EDS file."""
    return ["--bus", yaml.safe_load(bench.read_text())["bus"]["address"], "--eds", str(EDS)]


def test_scan_tells_who_is_there_and_who_is_missing(bench: Path) -> None:
    done = hilbench("scan", "--config", bench, "--listen", "0.1", "--json")
    data = json.loads(done.stdout)
    assert [station["part"] for station in data["stations"]] == ["axis1", "axis2", "load"], data
    first = data["stations"][0]
    assert first["identity"]["product_code"] == 0x402
    assert first["eds"].endswith("hilbench_servo.eds")
    assert first["firmware"] == "1.0"
    assert first["drive_state"] == "SWITCH ON DISABLED"
    assert [problem.partition(" ")[0] for problem in data["problems"]] == [
        "virtual_axis1",
        "virtual_axis2",
        "virtual_io",
    ]
    assert done.returncode == 1


def test_sdo_reads_and_writes_by_index_and_name_with_units(bench: Path) -> None:
    written = hilbench("sdo", "write", "axis1", "quick_stop_deceleration", "75 rad/s^2", "--config", bench)
    assert written.returncode == 0, written.stderr
    read = hilbench("sdo", "read", "1", "6085h", *attached(bench), "--json")
    data = json.loads(read.stdout)
    assert (data["value"], data["si_unit"]) == (7161972, "rad/s²")
    assert data["si"] == pytest.approx(75.0, rel=1e-6)
    text = hilbench("sdo", "read", "3", "1008", *attached(bench)).stdout
    assert text == "node 3 1008h:0 Manufacturer device name: hilbench servo\n"


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("1000h", "92 01 02 00 (4 bytes, {}); as unsigned 131474 (20192h)"),
        ("0x1018sub2", "02 04 00 00 (4 bytes, {}); as unsigned 1026 (402h)"),
        ("1008", "68 69 6c 62 65 6e 63 68 20 73 65 72 76 6f (14 bytes, {}); as text hilbench servo"),
    ],
)
@pytest.mark.parametrize("with_eds", [False, True])
def test_any_object_can_be_read_without_an_eds_that_tells_of_it(
    bench: Path, tmp_path: Path, name: str, shown: str, with_eds: bool
) -> None:
    eds, why = tmp_path, "no EDS file"
    if with_eds:  # of another device, which has nothing but what every device has
        eds, why = tmp_path / "bare.eds", "not in its EDS"
        eds.write_text("[DeviceInfo]\nVendorName=x\n[MandatoryObjects]\nSupportedObjects=1\n1=0x1001\n" + _REGISTER)
    done = hilbench("sdo", "read", "1", name, "--bus", attached(bench)[1], "--eds", eds)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.partition(": ")[2].strip() == shown.format(why)
    data = json.loads(hilbench("sdo", "read", "1", name, "--bus", attached(bench)[1], "--eds", eds, "--json").stdout)
    assert bytes.fromhex(data["value"]) == bytes.fromhex(shown.partition(" (")[0])


_REGISTER = """[1001]
ParameterName=Error register
ObjectType=0x7
DataType=0x0005
AccessType=ro
PDOMapping=0
"""


def test_what_a_device_refuses_or_nobody_answers_is_one_line_without_an_eds(bench: Path, tmp_path: Path) -> None:
    attach = ["--bus", attached(bench)[1], "--eds", tmp_path]
    refused = hilbench("sdo", "read", "1", "5FFF", *attach)
    assert refused.returncode == 3
    assert "node 1, 5FFFh:0: reading it: abort 06020000h" in refused.stderr
    silent = hilbench("sdo", "read", "99", "1000", *attach)
    assert silent.returncode == 3
    assert "no answer from node 99" in silent.stderr
    named = hilbench("sdo", "read", "1", "statusword", *attach)  # a name is known to an EDS file only
    assert named.returncode == 2
    assert "no EDS file with the identity of node 1" in named.stderr


@pytest.mark.parametrize(
    ("answer", "code", "said"),
    [
        ("4341600037120000", 3, "4 bytes for data type 0006h, expected 2"),
        ("4f41600037000000", 3, "1 bytes for data type 0006h, expected 2"),
        ("4b41600037120000", 0, "4663 (1237h)"),
        ("4241600037120000", 0, "4663 (1237h)"),  # expedited without a size: the type's bytes are meant
    ],
)
def test_an_answer_of_another_length_than_the_eds_says_is_no_number(
    tmp_path: Path, answer: str, code: int, said: str
) -> None:
    address = BusAddress.parse(f"embedded:t{uuid.uuid4().hex[:10]}")
    link, done = open_link(address), threading.Event()

    def device() -> None:
        while not done.is_set():
            for frame in link.receive(0.02):
                if frame.can_id == 0x605:
                    link.send([Frame(0x585, bytes.fromhex(answer))])

    thread = threading.Thread(target=device)
    thread.start()
    try:
        read = hilbench("sdo", "read", "5", "6041", "--bus", address, "--eds", EDS)
    finally:
        done.set()
        thread.join()
        link.close()
    assert read.returncode == code
    assert said in read.stdout + read.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["sdo", "read", "1", "target_speed"], 2, "no object named 'target_speed'"),
        (
            ["sdo", "write", "1", "target_velocity", "3 N·m"],
            2,
            "unit 'N·m' of 60FFh:0 'Target velocity', expected rad/s",
        ),
        (["sdo", "write", "1", "statusword", "1"], 3, "6041h sub 0 'Statusword': writing 1 to it: abort 06010002h"),
        (["drive", "1", "jog"], 2, "no terminal, expected one: its keys are the dead-man switch"),
    ],
)
def test_what_does_not_work_is_one_line(bench: Path, arguments: list[str], code: int, said: str) -> None:
    done = hilbench(*arguments, *attached(bench))
    assert (done.returncode, done.stdout) == (code, "")
    assert said in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_drive_turns_while_the_dead_man_key_is_held_and_is_without_power_afterwards(bench: Path) -> None:
    link = open_link(BusAddress.parse(attached(bench)[1]).as_it_runs())
    ours, theirs = pty.openpty()
    jog = subprocess.Popen(
        [*HILBENCH, "drive", "1", "jog", "--speed", "20", "--json", *attached(bench)],
        stdin=theirs,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert jog.stderr is not None
    assert b"hold f" in jog.stderr.readline()
    targets = Targets(link)
    held_until_s = time.monotonic() + 1.5
    while time.monotonic() < held_until_s:
        os.write(ours, b"f")  # a terminal repeats a key that is held
        targets.listen(0.03)
    assert targets.seen == [pytest.approx(20.0, abs=1e-3)]
    targets.listen(1.0)
    assert targets.seen == [pytest.approx(20.0, abs=1e-3), 0.0]
    os.write(ours, b"q")
    out, _ = jog.communicate(timeout=30)
    assert jog.returncode == 0
    status = json.loads(out)
    assert status["state"] == "SWITCH ON DISABLED"
    assert status["position_rad"] > 5.0
    assert abs(status["velocity_rad_s"]) < 0.1
    link.close()
    os.close(ours)
    os.close(theirs)


class Targets:
    """The target velocities (rad/s) that node 1 is given by SDO from now on, as a listener hears them."""

    unit_rad_s = 2 * math.pi / 60 * 1e-4  # 60A9h of the EDS: 0.0001 rpm

    def __init__(self, link: Link) -> None:
        self.seen: list[float] = []
        self._link = link
        link.receive(0.0)

    def listen(self, duration_s: float) -> None:
        for frame in receive_for(self._link, duration_s):
            if frame.can_id == 0x601 and frame.data[:4] == bytes.fromhex("23FF6000"):
                self.seen.append(int.from_bytes(frame.data[4:], "little", signed=True) * self.unit_rad_s)
