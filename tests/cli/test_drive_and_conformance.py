"""`hilbench drive` and `hilbench conformance` as a user starts them, on simulated drives on a bus of their own."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi
from pathlib import Path
from xml.etree import ElementTree

import pytest
from tests.cia402.every_mode import eds_file
from tests.cli.in_process import hilbench, nobody_else
from tests.tiers import slow

from hilbench.can.open import BusAddress, open_link
from hilbench.canopen.listening import present, receive_for

HILBENCH = [sys.executable, "-m", "hilbench"]
#: 60 rpm into 60FFh, whose unit is 0.0001 rpm.
SPEED = bytes.fromhex("23FF6000") + (600_000).to_bytes(4, "little")
SERVO = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"


@dataclass(frozen=True)
class Bus:
    """The servo drive as node 1, the drive with every mode as node 2, each on a bus of its own."""

    servo: tuple[object, ...]
    every_mode: tuple[object, ...]


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bus]:
    files = {1: SERVO, 2: eds_file(tmp_path_factory.mktemp("eds"))}
    buses = {node: f"embedded:{uuid.uuid4().hex[:12]}" for node in files}
    running = [
        subprocess.Popen([*HILBENCH, "simulate-drive", eds, "--node", str(node), "--bus", buses[node]])
        for node, eds in files.items()
    ]
    try:
        for node, address in buses.items():
            link = open_link(BusAddress.parse(address))
            assert any(present(link, [node], 0.2) for _ in range(300)), "the drive does not answer"
            link.close()
        servo, every_mode = (("--bus", buses[node], "--eds", eds) for node, eds in files.items())
        with nobody_else():
            yield Bus(servo, every_mode)
    finally:
        for process in running:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=20)


def status(node: int, there: tuple[object, ...]) -> dict[str, object]:
    done = hilbench("drive", node, "status", "--json", *there)
    assert done.returncode == 0, done.stderr
    data: dict[str, object] = json.loads(done.stdout)
    return data


def test_a_drive_moves_homes_and_turns_by_command(bus: Bus) -> None:
    done = hilbench("drive", 2, "home", "35", *bus.every_mode)
    assert (done.returncode, done.stderr) == (0, "")
    done = hilbench("drive", 2, "move", "2000 units", "--speed", "30", "--json", *bus.every_mode)
    assert done.returncode == 0, done.stderr
    shown = json.loads(done.stdout)
    assert shown["state"] == "SWITCH ON DISABLED"
    assert shown["position_units"] == pytest.approx(2000, abs=200)  # without power it runs on a little
    before = status(1, bus.servo)["position_rad"]
    done = hilbench("drive", 1, "velocity", "100 rpm", "--for", "0.3", "--json", *bus.servo)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["position_rad"] > before


@pytest.fixture
def silent_on_units(tmp_path: Path) -> Iterator[tuple[object, ...]]:
    """A drive whose objects tell none of its units, as node 3."""
    eds, address = eds_file(tmp_path, 0x608F, 0x60A9, 0x6076), f"embedded:{uuid.uuid4().hex[:12]}"
    process = subprocess.Popen([*HILBENCH, "simulate-drive", eds, "--node", "3", "--bus", address])
    try:
        link = open_link(BusAddress.parse(address))
        assert any(present(link, [3], 0.2) for _ in range(300)), "the drive does not answer"
        link.close()
        with nobody_else():
            yield "--bus", address, "--eds", eds
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=20)


def test_a_drive_that_does_not_tell_its_units_names_the_objects_and_takes_them_by_option(
    silent_on_units: tuple[object, ...],
) -> None:
    refused = hilbench("drive", 3, "velocity", "60 rpm", "--for", "0.3", *silent_on_units)
    assert refused.returncode == 2
    assert refused.stderr == (
        "hilbench: node (node 3): 608Fh is absent or 0, and so is 6092h, expected it or the unit 'position_rad'; "
        "60A9h is absent, expected it or the unit 'velocity_rad_s' (--units KEY=VALUE, or units: of the drive in "
        "--config)\n"
    )
    given = ["--units", f"position_rad={2 * pi / 4096}", "--units", f"velocity_rad_s={2 * pi / 60}"]
    turned = hilbench("drive", 3, "velocity", "60 rpm", "--for", "0.5", *given, "--json", *silent_on_units)
    assert turned.returncode == 0, turned.stderr
    assert json.loads(turned.stdout)["position_rad"] == pytest.approx(pi, rel=0.5)
    odd = hilbench("drive", 3, "status", "--units", "velocity=1", *silent_on_units)
    assert odd.returncode == 2
    assert "--units: 'velocity=1', expected position_rad, velocity_rad_s or rated_torque_Nm" in odd.stderr


def test_status_shows_si_units_the_drives_own_and_what_it_lacks(bus: Bus) -> None:
    done = hilbench("drive", 1, "status", *bus.servo)
    state, mode, values, lacking = done.stdout.splitlines()
    assert state.startswith("SWITCH ON DISABLED  (statusword 0")
    assert mode.startswith("mode ")
    assert [part.split()[1] for part in values.split(", ")] == ["rad", "rad/s", "N·m"]
    assert values.count(" units)") == 3
    assert lacking == "profile position can't be used: 6502h is 3ACh, without bit 0"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["move", "1 turn"], "6502h is 3ACh, without bit 0: profile position can't be used"),
        (["velocity", "60"], "VALUE: '60', expected a number with rad/s, rpm, units, e.g. \"10 rad/s\""),
        (["velocity"], "VALUE: missing, expected a number with rad/s, rpm, units"),
        (["velocity", "9000 rpm"], "942.478 rad/s, expected at most 314.159 rad/s (607Fh)"),
        (["torque", "900 N·m"], "900 N·m, expected at most"),
        (["home", "here"], "VALUE: 'here', expected a homing method (6098h), e.g. 35"),
        (["status", "1 rad"], "VALUE: '1 rad' with status, expected none"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_nothing_moves(bus: Bus, words: list[str], said: str) -> None:
    done = hilbench("drive", 1, *words, *bus.servo)
    assert (done.returncode, done.stdout) == (2, "")
    assert said in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert status(1, bus.servo)["state"] == "SWITCH ON DISABLED"


def eventually(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("end", "code"),
    [(signal.SIGKILL, -9), *slow((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129))],
)
def test_however_it_ends_the_motor_is_at_rest_without_torque(bus: Bus, end: signal.Signals, code: int) -> None:
    link = open_link(BusAddress.parse(str(bus.servo[1])))
    command = [*HILBENCH, "drive", "1", "velocity", "60 rpm", *map(str, bus.servo)]
    turning = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    turns = False
    while not turns:  # a second SDO client would disturb the first: only listen
        turns = any(frame.can_id == 0x601 and frame.data == SPEED for frame in receive_for(link, 0.1))
        assert turning.poll() is None
    receive_for(link, 1.0)
    turning.send_signal(end)
    _, told = turning.communicate(timeout=30)
    link.close()
    assert turning.returncode == code
    said = {signal.SIGKILL: "", signal.SIGINT: "hilbench: interrupted\n"}
    assert told.decode() == said.get(end, f"hilbench: interrupted ({end.name})\n")
    eventually(lambda: status(1, bus.servo)["state"] == "SWITCH ON DISABLED")
    eventually(lambda: abs(float(str(status(1, bus.servo)["velocity_rad_s"]))) < 0.5)
    if end is signal.SIGKILL:  # nobody was there to take the watch back
        assert hilbench("sdo", "write", "1", "1016:1", "0", *bus.servo).returncode == 0


# -- conformance -----------------------------------------------------------------------------------------------


def test_a_device_is_examined_and_left_as_it_was(bus: Bus, tmp_path: Path) -> None:
    address, eds = bus.servo[1], bus.servo[3]
    there = ("--bus", address, "--node", "1", "--eds", eds)
    assert hilbench("sdo", "write", "1", "1017", "250", *bus.servo).returncode == 0
    xml, page = tmp_path / "verdicts.xml", tmp_path / "page.html"
    groups = ("--only", "SDO", "--only", "Drive states", "--only", "EMCY")
    done = hilbench("conformance", *there, *groups, "--junit", xml, "--html", page)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert done.stdout.splitlines()[:-2] == [
        "SDO           24 passed, 6 not applicable",
        "EMCY          6 passed",
        "Drive states  4 passed, 1 not applicable, 4 not allowed",
        "Afterwards    1 passed",
        "passed  hilbench servo, node 1: 35 passed, 7 not applicable, 4 not allowed",
        "more with --allow-motion",
    ]
    suite = ElementTree.parse(xml).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("46", "0", "11")
    text = page.read_text(encoding="utf-8")
    assert "601 40 00 10 00 00 00 00 00" in text
    assert "CiA 301, 7.2.4.3.6 and table 22" in text
    read = hilbench("sdo", "read", "1", "1017", "--json", *bus.servo)
    assert json.loads(read.stdout)["value"] == 250
    assert hilbench("sdo", "write", "1", "1017", "0", *bus.servo).returncode == 0


def test_a_device_that_differs_from_its_file_fails_with_exit_code_1(bus: Bus, tmp_path: Path) -> None:
    other = tmp_path / "other.eds"
    text = SERVO.read_text(encoding="ascii")
    before = "[1018sub2]"
    at = text.index(before)
    other.write_text(text[:at] + text[at:].replace("DefaultValue=", "DefaultValue=0x1 ;", 1), encoding="ascii")
    arguments = ("--bus", bus.servo[1], "--node", "1", "--eds", other, "--only", "OD", "--json")
    done = hilbench("conformance", *arguments)
    data = json.loads(done.stdout)
    assert done.returncode == 1
    [failed] = [case for case in data["cases"] if case["verdict"] == "failed"]
    assert (failed["group"], failed["number"]) == ("OD", 2)
    [wrong] = [step for step in failed["steps"] if not step["ok"]]
    assert (wrong["expected"], wrong["seen"]) == ("01 00 00 00", "02 04 00 00")


def test_nobody_who_answers_and_a_group_that_is_none_are_one_line(bus: Bus) -> None:
    there = ("--bus", bus.servo[1], "--eds", SERVO)
    silent = hilbench("conformance", *there, "--node", "9")
    assert (silent.returncode, silent.stderr) == (3, "hilbench: node 9: no answer to an SDO read of 1000h\n")
    unknown = hilbench("conformance", *there, "--node", "1", "--only", "LSS")
    assert unknown.returncode == 2
    assert "'LSS', expected one of EDS, SDO, PDO" in unknown.stderr
