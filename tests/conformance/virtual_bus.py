"""A simulated drive and its examiner in one thread: time is counted, not waited for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.canopen.device_under_test import HandClock

from hilbench.apps.conformance.description import Description
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.wire import Wire
from hilbench.apps.devices.application import DrivesApplication
from hilbench.apps.devices.behaviour import Behaviour
from hilbench.apps.devices.simulation import simulated_axes
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import NMT

_STEP_NS = 1_000_000
SERVO_EDS = Path(__file__).parents[2] / "eds" / "hilbench_servo.eds"


class VirtualBus(Wire):
    """The wire of an examiner. Faults are put in by `says` and `hears` (another frame, or None), and by `steps`, which
    are done before the drive looks at anything."""

    def __init__(self, eds: Path = SERVO_EDS, node_id: int = 5, behaviour: Behaviour | None = None) -> None:
        self.clock = HandClock()
        nodes = simulated_axes(eds, node_id, self.clock, behaviour)
        self.node = nodes[0]
        self.application = DrivesApplication(nodes, self.clock.now_ns)
        self.device = self.node.device
        self.says: list[Callable[[Frame], Frame | None]] = []
        self.hears: list[Callable[[Frame], Frame]] = []
        self.steps: list[Callable[[], None]] = []
        self._received: list[Frame] = []
        self.device.boot()
        self._collect()
        self._received.clear()

    def now_s(self) -> float:
        return self.clock.ns * 1e-9

    def send(self, can_id: int, data: bytes) -> None:
        self._step()
        for receive in self.hears:
            can_id, data, _ = receive(Frame(can_id, data))
        if can_id == self.device.sync_cob_id and can_id != NMT:
            self.application.before_sync(0)
            self.device.sync(data)
            self.application.after_sync()
        else:
            self.device.handle(Frame(can_id, data))
        self._collect()

    def put(self, frame: Frame) -> None:
        """On the wire, from whomever."""
        self._received.append(frame._replace(time_ns=self.clock.ns))

    def listen(self, duration_s: float, until: Callable[[Frame], bool] | None = None) -> list[Frame]:
        found: list[Frame] = []
        deadline_ns = self.clock.ns + round(duration_s * 1e9)
        while True:
            while self._received:
                found.append(self._received.pop(0))
                if until is not None and until(found[-1]):
                    return found
            if self.clock.ns >= deadline_ns:
                return found
            self.clock.ns += _STEP_NS
            self._step()
            self.application.tick(_STEP_NS * 1e-9)
            self.device.poll()
            self._collect()

    def _step(self) -> None:
        for step in self.steps:
            step()

    def _collect(self) -> None:
        device = self.device
        for frame in (*device.replies, *device.outbox):
            said: Frame | None = frame
            for say in self.says:
                said = None if said is None else say(said)
            if said is not None:
                self.put(said)
        device.replies.clear()
        device.outbox.clear()


def under_test(bus: VirtualBus, eds: Path = SERVO_EDS, *, motion: bool = False, store: bool = False) -> DeviceUnderTest:
    node_id = bus.device.node_id
    return DeviceUnderTest(bus, node_id, Description(eds, node_id), motion=motion, store=store)
