"""Masters with a SYNC period of their own on `hilbench simulate-hardware`, as somebody starts it for them.

canopen's BaseNode402 and npm's canopen, each by its own timer, on the interface that HILBENCH_VCAN names. Without a
kernel's CAN the same is tested with a clock set by hand: tests/bench/test_foreign_sync.py.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from math import pi
from pathlib import Path

import pytest
from canopen.profiles.p402 import BaseNode402
from tests.buses import KernelBus
from tests.foreign.foreign_station import foreign_station, with_node_id

from canopen import Network
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.canopen.eds import load_eds
from hilbench.canopen.listening import present

pytestmark = pytest.mark.vcan

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "tests" / "vcan" / "step_change.yaml"
EDS = ROOT / "eds" / "hilbench_servo.eds"
PERIODS_MS = [5, 10, 20]
RPM = 10_000
POSITION_RAD, VELOCITY_RAD_S = 2 * pi / (1 << 20), 2 * pi / 60 * 1e-4
PROFILE_VELOCITY, ENABLE = 3, (0x06, 0x07, 0x0F)
SPEED_RPM, TURNING_S, PATIENCE_S = 300, 2.0, 60.0


@pytest.fixture(scope="module")
def address() -> BusAddress:
    return KernelBus().address


@pytest.fixture(scope="module")
def hardware(address: BusAddress, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Simulated hardware that nobody paces, and where it says what."""
    log = tmp_path_factory.mktemp("hardware") / "said.log"
    words = [sys.executable, "-m", "hilbench", "simulate-hardware", str(CONFIG), "--bus", str(address)]
    with log.open("wb") as file:
        process = subprocess.Popen(words, stdout=file, stderr=file)
    link = open_link(address)
    try:
        until(lambda: bool(present(link, [1], 0.5)), 4 * PATIENCE_S)
        yield log
    finally:
        link.close()
        process.terminate()
        process.wait(PATIENCE_S)


def until(holds: Callable[[], bool], patience_s: float = PATIENCE_S) -> None:
    deadline_s = time.monotonic() + patience_s
    while not holds():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


class Witness:
    """Time of each SYNC, and the position and velocity with which node 1 answered it; SI."""

    def __init__(self, link: Link) -> None:
        self.answers: list[tuple[float, float, float]] = []
        self._link = link
        self._synced_s, self._position = 0.0, None

    @property
    def velocity_rad_s(self) -> float:
        return self.answers[-1][2] if self.answers else 0.0

    def listen(self, stop: threading.Event) -> None:
        while not stop.is_set():
            for frame in self._link.receive(0.05):
                if frame.can_id == 0x80:
                    self._synced_s = time.monotonic()
                elif frame.can_id == 0x181:
                    self._position = int.from_bytes(frame.data[4:8], "little", signed=True) * POSITION_RAD
                elif frame.can_id == 0x281 and self._position is not None:
                    velocity = int.from_bytes(frame.data[:4], "little", signed=True) * VELOCITY_RAD_S
                    self.answers.append((self._synced_s, self._position, velocity))


@contextmanager
def witness(address: BusAddress) -> Iterator[Witness]:
    link, stop = open_link(address), threading.Event()
    made = Witness(link)
    thread = threading.Thread(target=made.listen, args=(stop,))
    thread.start()
    try:
        yield made
    finally:
        stop.set()
        thread.join()
        link.close()


def turn_and_judge(seen: Witness, command: Callable[[int, int], None], period_ms: int) -> None:
    """Enable, turn for a while, stop; the position has to fit the integral of the velocity."""

    def give(controlword: int) -> None:
        command(controlword, 0)
        answered = len(seen.answers)
        until(lambda: len(seen.answers) > answered + 3)

    for controlword in ENABLE:
        give(controlword)
    command(0x0F, SPEED_RPM * RPM)
    speed = SPEED_RPM * 2 * pi / 60
    until(lambda: seen.velocity_rad_s > 0.99 * speed)
    first = len(seen.answers)
    start_s = time.monotonic()
    until(lambda: time.monotonic() > start_s + TURNING_S)
    answers = seen.answers[first:]
    command(0x0F, 0)
    until(lambda: abs(seen.velocity_rad_s) < 0.1)
    give(0x00)
    travel = answers[-1][1] - answers[0][1]
    integral = sum((later[0] - one[0]) * (one[2] + later[2]) / 2 for one, later in pairwise(answers))
    seconds = answers[-1][0] - answers[0][0]
    print(
        f"SYNC every {period_ms} ms: {len(answers)} answers in {seconds:.2f} s, position {travel:.2f} rad, integral of "
        f"the velocity {integral:.2f} rad"
    )
    assert seconds > 0.5 * TURNING_S
    assert integral == pytest.approx(speed * seconds, rel=0.02)
    assert travel == pytest.approx(integral, rel=0.02)


@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_base_node_402(address: BusAddress, hardware: Path, period_ms: int) -> None:
    with witness(address) as seen:
        network = Network(open_python_can(address))
        network.connect()
        node = BaseNode402(1, load_eds(EDS, 1))
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 10.0
        try:
            node.nmt.state = "PRE-OPERATIONAL"
            node.setup_402_state_machine()
            node.nmt.state = "OPERATIONAL"
            node.sdo[0x6060].raw = PROFILE_VELOCITY
            network.sync.start(period_ms * 1e-3)

            def command(controlword: int, target: int) -> None:
                node.rpdo[1][0x6040].raw = controlword
                node.rpdo[1][0x60FF].raw = target
                node.rpdo[1].transmit()

            turn_and_judge(seen, command, period_ms)
        finally:
            network.sync.stop()
            node.nmt.state = "PRE-OPERATIONAL"
            network.disconnect()


@pytest.mark.skipif(shutil.which("npm") is None, reason="Node.js with npm is not installed")
@pytest.mark.parametrize("period_ms", PERIODS_MS)
def test_npms_canopen(address: BusAddress, hardware: Path, period_ms: int, tmp_path: Path) -> None:
    file = tmp_path / "servo.eds"
    file.write_text(with_node_id(EDS.read_text(encoding="ascii"), 1), encoding="ascii")
    with witness(address) as seen, foreign_station(open_link(address), 1, file) as station:
        station.nmt("startNode")
        station.download(0x6060, 0, bytes([PROFILE_VELOCITY]))
        station.sync_every(period_ms)
        try:
            turn_and_judge(seen, station.command, period_ms)
        finally:
            station.nmt("enterPreOperational")


def test_the_hardware_has_said_that_sync_is_another(hardware: Path) -> None:
    """Once, though there were several masters."""
    said = hardware.read_text().splitlines()
    assert len(said) == 1
    assert "cycle_time_s is 2 ms: the simulated hardware goes by time" in said[0]
