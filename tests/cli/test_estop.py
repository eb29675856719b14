"""`hilbench estop` without a bus: it finds what there is to stop, and says what it could not reach."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from tests.bench.whole_runs import SHORT, config
from tests.cli.in_process import hilbench

from hilbench.apps.commands import estop
from hilbench.can import interfaces
from hilbench.can.claims import MASTER, Holder, holders
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus, MemoryLink
from hilbench.can.open import BusAddress
from hilbench.canopen.emergency_stop import EMERGENCY_STOP_COB_ID
from hilbench.errors import BusError

ROOT = Path(__file__).resolve().parents[2]
OWN_NAMESPACE = ["unshare", "--net"] if os.getuid() == 0 else ["unshare", "--map-root-user", "--net"]
BENCH = Holder("socketcan:can0", MASTER, pid=4711, uid=os.getuid(), what="bench line2", bitrate=500_000)


def may_have_a_namespace() -> bool:
    try:
        return subprocess.run([*OWN_NAMESPACE, "true"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not may_have_a_namespace(), reason="no network namespace of its own is permitted here")
def test_every_bench_of_the_machine_stops_whatever_session_it_is_in(tmp_path: Path) -> None:
    paths = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        paths.append(config(tmp_path / name, steps=[SHORT[0], {"hold": {"duration_s": 1000.0}}]))
    command = [*OWN_NAMESPACE, sys.executable, "-m", "tests.cli.estop_everywhere", *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["exit_code"], found["err"]) == (0, "")
    lines = found["out"].strip().splitlines()
    assert len(lines) == len(paths)
    for pid, code, words in found["benches"]:
        assert any("emergency stop sent" in line and f"process {pid}" in line for line in lines), lines
        assert code == 3
        assert "emergency stop (COB-ID 001h)" in words.replace("\n", " ")


@dataclass
class Machine:
    """What `hilbench estop` finds on a machine that a test makes up."""

    holders: list[Holder] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    interfaces: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    buses: dict[str, MemoryBus] = field(default_factory=dict)
    bitrates: dict[str, int] = field(default_factory=dict)
    listeners: dict[str, MemoryLink] = field(default_factory=dict)

    def open_link(self, bus: BusAddress) -> MemoryLink:
        if str(bus) in self.broken:
            raise BusError(f"{bus}: took no frame for 1 s")
        self.bitrates[str(bus)] = bus.bitrate
        wire = self.buses.setdefault(str(bus), MemoryBus())
        self.listeners[str(bus)] = wire.open_link()
        return wire.open_link()

    def stopped(self) -> list[str]:
        return sorted(bus for bus, link in self.listeners.items() if received(link.receive(0.0)))


def received(frames: Iterable[Frame]) -> bool:
    return any(frame.can_id == EMERGENCY_STOP_COB_ID for frame in frames)


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    made = Machine()
    monkeypatch.setattr(estop.claims, "holders", lambda answer_s: made.holders)
    monkeypatch.setattr(estop, "running_channels", lambda: made.channels)
    monkeypatch.setattr(estop, "can_interfaces_up", lambda: made.interfaces)
    monkeypatch.setattr(estop, "open_link", made.open_link)
    return made


def test_benches_and_interfaces_that_are_up_are_stopped_each_once(machine: Machine) -> None:
    machine.holders = [BENCH, replace(BENCH, role="node1"), replace(BENCH, place="pcan:PCAN_USBBUS1", bitrate=250_000)]
    machine.interfaces = ["can0", "can1"]
    done = hilbench("estop")
    assert (done.returncode, done.stderr) == (0, "")
    assert machine.stopped() == ["pcan:PCAN_USBBUS1", "socketcan:can0", "socketcan:can1"]
    assert machine.bitrates["pcan:PCAN_USBBUS1"] == 250_000
    assert len(done.stdout.strip().splitlines()) == 3
    assert "bench line2" in done.stdout


def test_a_bench_that_could_not_be_told_is_one_clear_line_and_not_exit_0(machine: Machine) -> None:
    machine.holders, machine.interfaces, machine.broken = [BENCH], ["can0", "can1"], ["socketcan:can0"]
    done = hilbench("estop")
    assert done.returncode == 3
    (line,) = done.stderr.strip().splitlines()
    for text in ("NOT STOPPED", "socketcan:can0", "bench line2", "process 4711"):
        assert text in line
    assert machine.stopped() == ["socketcan:can1"]  # the others are stopped all the same


def test_a_bit_rate_that_nobody_says_is_not_guessed(machine: Machine) -> None:
    machine.holders = [replace(BENCH, place="pcan:PCAN_USBBUS1", bitrate=None)]
    done = hilbench("estop")
    assert done.returncode == 3
    assert "its bit rate is unknown" in done.stderr
    assert machine.bitrates == {}


def test_an_interface_without_a_bench_that_takes_no_frame_is_said(machine: Machine) -> None:
    machine.interfaces, machine.broken = ["can0", "can1"], ["socketcan:can1"]
    done = hilbench("estop")
    assert done.returncode == 0
    assert "NOT STOPPED: socketcan:can1" in done.stderr
    machine.broken = ["socketcan:can0", "socketcan:can1"]
    assert hilbench("estop").returncode == 3  # nothing at all was reached


def test_another_users_embedded_bus_is_said_and_left_alone(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 4711)
    machine.holders = [replace(BENCH, place="embedded:/run/user/4712/hilbench/line.sock", uid=4712)]
    machine.interfaces = ["can0"]
    done = hilbench("estop")
    assert done.returncode == 0
    assert "/run/user/4712/hilbench/line.sock: left alone" in done.stdout
    assert machine.stopped() == ["socketcan:can0"]


def test_where_benches_cannot_be_asked_the_interfaces_are_stopped_all_the_same(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(estop.claims, "holders", holders)
    monkeypatch.setattr(estop.claims, "_SOCKETS", tmp_path / "unix")
    machine.interfaces = ["can0"]
    done = hilbench("estop")
    assert done.returncode == 3
    assert "NOT ALL BENCHES ARE KNOWN" in done.stderr
    assert machine.stopped() == ["socketcan:can0"]


def test_nothing_to_stop_is_exit_2(machine: Machine) -> None:
    done = hilbench("estop")
    assert done.returncode == 2
    assert "expected one, or --bus" in done.stderr


def test_only_can_interfaces_that_are_up_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interfaces, "SYSFS", tmp_path)
    for name, kind, flags in (
        ("can0", 280, "0x41"),
        ("can1", 280, "0x40"),
        ("eth0", 1, "0x1003"),
        ("vcan0", 280, "0x1"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
    (tmp_path / "gone0").mkdir()
    assert interfaces.can_interfaces_up() == ["can0", "vcan0"]
