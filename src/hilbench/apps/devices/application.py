"""Application of simulated drives on their host: shafts that turn, and scheduled events."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from math import pi
from typing import Final

from hilbench.apps.devices.behaviour import Event
from hilbench.apps.devices.node import NodeIdGiven, SimulatedNode
from hilbench.can.frame import Frame
from hilbench.hardware.plant_time import ByClock
from hilbench.hardware.simulation import RigApplication
from hilbench.plant.motor_port import MotorMode

#: Sample time of the drives' control loops, and how often they look at their set points at least.
SAMPLE_S: Final = 0.001
CYCLE_S: Final = 0.002


class DrivesApplication:
    """The `Application` of a host: each drive on a shaft of its own, all by one clock.

    Other threads act on the drives by `ask`: what they ask for is done between two cycles, by the host's thread.
    """

    def __init__(self, nodes: Sequence[SimulatedNode], now_ns: Callable[[], int]) -> None:
        self._faulty = [FaultyDrive(node, now_ns) for node in nodes]
        self.listens_to: frozenset[int] = frozenset()
        self._lss: NodeIdGiven | None = None
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._rig = RigApplication(
            [node.drive for node in nodes],
            [node.port for node in nodes],
            self,
            ByClock(CYCLE_S, SAMPLE_S, now_ns, lambda _text: None, any_period=True),
            CYCLE_S,
        )

    def ask(self, what: Callable[[], None]) -> None:
        """Do this soon; may be called from any thread."""
        self._asked.put(what)

    def faulty(self, number: int) -> FaultyDrive:
        """The drive of that place, for what goes wrong with it."""
        return self._faulty[number]

    def before_sync(self, behind: int) -> None:
        """Advance by the clock, whatever the period of SYNC."""
        self._happen()
        self._rig.before_sync(behind)

    def after_sync(self) -> None:
        """Set points act."""
        self._rig.after_sync()

    def tick(self, duration_s: float) -> None:
        """No SYNC runs: time goes on all the same."""
        self._happen()
        self._rig.tick(duration_s)

    def step(self, duration_s: float) -> None:
        """Turn all shafts for so long."""
        for drive in self._faulty:
            drive.step(duration_s)

    def put_beside(self, lss: NodeIdGiven) -> None:
        """Add an LSS slave that receives its own frames for the node."""
        self._lss, self.listens_to = lss, lss.listens_to

    def on_frame(self, frame: Frame) -> None:
        """A frame of LSS, or one for all; others don't concern a drive."""
        if self._lss is not None:
            self._lss.on_frame(frame)

    def _happen(self) -> None:
        while not self._asked.empty():
            self._asked.get()()
        for drive in self._faulty:
            drive.happen()


class FaultyDrive:
    """A drive's own events, and what a test does to it."""

    def __init__(self, node: SimulatedNode, now_ns: Callable[[], int]) -> None:
        self._node = node
        self._now_ns = now_ns
        self._power_on_ns = now_ns()
        own = (event for event in node.behaviour.events if event.axis == node.axis)
        self._events = sorted(own, key=lambda event: event.at_s)
        self._jumped_rad = 0.0
        self._in_use = False
        #: When heartbeats, and everything, are sent again.
        self._no_heartbeat_until_ns = self._silent_until_ns = 0

    def step(self, duration_s: float) -> None:
        """Turn the shaft, once the drive has had power; the encoder shows it with its jumps."""
        self._in_use = self._in_use or self._node.port.mode is not MotorMode.OFF
        if not self._in_use:  # of a hundred drives on a bus most rest
            return
        self._node.rig.lock_to(duration_s)
        self._node.rig.step(duration_s)
        self._node.port.position_rad += self._jumped_rad

    def happen(self) -> None:
        """Cause the events that are due."""
        now_ns = self._now_ns()
        while self._events and (now_ns - self._power_on_ns) * 1e-9 >= self._events[0].at_s:
            self.cause(self._events.pop(0))
        if self._node.axis > 1:
            return  # what the node sends is the first axis' to fail
        device = self._node.device
        device.silent = now_ns < self._silent_until_ns
        device.heartbeat_fails = now_ns < self._no_heartbeat_until_ns

    def cause(self, event: Event) -> None:
        """Cause an event now."""
        device, now_ns = self._node.device, self._now_ns()
        if event.fault is not None:
            self._node.drive.fault(event.fault)
        elif event.emergency is not None:
            raised = event.emergency
            device.emergency(raised.code, raised.register_bits, bytes(raised.data))
        elif event.emergency_over is not None:
            device.clear_emergency(event.emergency_over)
        elif event.encoder_jump_turns is not None:
            self._jumped_rad += event.encoder_jump_turns * 2.0 * pi
            self._node.port.position_rad += event.encoder_jump_turns * 2.0 * pi
        elif event.no_heartbeat_s is not None:
            self._no_heartbeat_until_ns = now_ns + round(event.no_heartbeat_s * 1e9)
        elif event.silent_s is not None:
            self._silent_until_ns = now_ns + round(event.silent_s * 1e9)
        elif event.reset:
            device.reset_node()
