"""A simulated drive for a test: a context manager, on any python-can bus, with faults on command."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from copy import copy
from math import pi
from pathlib import Path
from types import TracebackType
from typing import Final, Self, TypeVar

from hilbench.apps.devices.application import NodeIdGiven, SimulatedNode, await_node_id, lss_address
from hilbench.apps.devices.behaviour import OF_AN_AXIS, Behaviour, Emergency, Event, load_behaviour
from hilbench.apps.devices.simulation import hosted, new_clock, simulated_axes
from hilbench.can.adapter import PythonCanLink
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link
from hilbench.can.python_can import can
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.lss_slave import UNCONFIGURED, LssSlave
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import State
from hilbench.cia402.units import RPM
from hilbench.errors import HilbenchError

_ANSWER_S: Final = 5.0
_FIRST_NODE: Final = 1
Result = TypeVar("Result")


class SimulatedDrive:
    """A CiA-402 drive as its EDS file describes it, alive while the `with` block runs.

        with SimulatedDrive("drive.eds", node_id=5, bus="socketcan:vcan0") as drive:
            ...  # your master drives it
            drive.fault(0x8611)

    `node_id`: None for one that has none and waits until a master gives it one by LSS (CiA 305), which can give it
    another one at any time; `serial_number` takes the place of the file's (1018h sub 4): by it LSS tells drives of one
    file apart. `bus`: ``interface:channel``, or a `can.BusABC` of its own, which is shut down at the end. `behaviour`:
    a file, or the object that it is read to. Several drives can be on one bus, each with a link of its own.
    Raises UnusableInputError for a file that is none of a CiA-402 drive.
    """

    def __init__(
        self,
        eds: str | Path,
        node_id: int | None,
        bus: str | can.BusABC,
        *,
        behaviour: str | Path | Behaviour | None = None,
        serial_number: int | None = None,
    ) -> None:
        self._bus, self._eds, self._serial_number = bus, Path(eds), serial_number
        self._behaviour = load_behaviour(Path(behaviour)) if isinstance(behaviour, str | Path) else behaviour
        self._axis = 1
        self._nodes: list[SimulatedNode] = []
        self._make(node_id or _FIRST_NODE)  # one without a node id is the same drive, which is not on the bus yet
        self._lss = LssSlave(lss_address(self._node.device), node_id or UNCONFIGURED)
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None

    def __enter__(self) -> Self:
        link = self._open()
        self._thread = threading.Thread(target=self._run, args=(link,), name="simulated-drive", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._error is not None and kind is None:
            raise self._error

    def _open(self) -> Link:
        if isinstance(self._bus, can.BusABC):
            return PythonCanLink(self._bus, str(getattr(self._bus, "channel_info", "")))
        return open_link(BusAddress.parse(self._bus))

    def _make(self, node_id: int) -> None:
        clock = new_clock()
        self._nodes[:] = simulated_axes(self._eds, node_id, clock, self._behaviour, serial_number=self._serial_number)
        self._hosted, self._application = hosted(self._nodes, clock)

    def _run(self, link: Link) -> None:
        try:
            time.sleep(self._node.behaviour.boot_s)
            while not self._stop.is_set():
                if self._lss.node_id == UNCONFIGURED:
                    await_node_id(link, self._lss, self._stop.is_set)
                else:
                    self._serve(link, self._lss.node_id)
        except HilbenchError as error:  # the bus was lost: who leaves the block learns it
            self._error = error
        finally:
            link.close()

    def _serve(self, link: Link, node_id: int) -> None:
        """Be the node with this id until the end, or until LSS has given it another one and it was reset."""
        if node_id != self._node.device.node_id:
            self._make(node_id)
        node_id_given = NodeIdGiven(self._lss, self._node.device)
        self._application.put_beside(node_id_given)
        DeviceHost(link, *self._hosted).run(lambda: self._stop.is_set() or node_id_given.takes_effect)

    # --- what it does -------------------------------------------------------------------------------------------------

    @property
    def node_id(self) -> int | None:
        """The node id that it has now."""
        return None if self._lss.node_id == UNCONFIGURED else self._lss.node_id

    def axis(self, number: int) -> Self:
        """Another axis of the same node (from 1), for what it shows and what goes wrong with it; ask for it once the
        node has its id. Raises KeyError for one that the EDS file lacks."""
        if not any(node.axis == number for node in self._nodes):
            raise KeyError(f"no axis {number}")
        other = copy(self)
        other._axis = number
        return other

    @property
    def _node(self) -> SimulatedNode:
        return next(node for node in self._nodes if node.axis == self._axis)

    @property
    def state(self) -> State:
        """Power state of the drive."""
        return self._node.drive.state

    @property
    def modes(self) -> list[OperationMode]:
        """Modes of operation that it has."""
        return self._node.modes

    @property
    def position_turns(self) -> float:
        """Turns of the motor since power-on, as the encoder shows them."""
        return self._node.port.position_rad / (2.0 * pi)

    @property
    def position_unit_rad(self) -> float:
        """Motor angle of one position unit (6064h, 607Ah)."""
        return self._node.units.position_rad

    @property
    def velocity_rpm(self) -> float:
        """Speed of the motor."""
        return self._node.port.velocity_rad_s / RPM

    @property
    def torque_Nm(self) -> float:
        """Torque of the motor."""
        return self._node.port.torque_Nm

    def read(self, index: int, sub: int = 0) -> object:
        """The value of an object. Raises KeyError for one that the EDS file lacks."""
        return self._node.device.cell(index, sub).value

    def write(self, index: int, value: object, sub: int = 0) -> None:
        """Write an object as over SDO. Raises KeyError, or canopen's SdoAbortedError where the drive refuses it."""
        self._do(lambda: self._node.device.cell(index, sub).write(value))

    # --- what goes wrong with it --------------------------------------------------------------------------------------

    def fault(self, code: int) -> None:
        """Fail with an error code (603Fh, EMCY): fault reaction, then FAULT."""
        self._cause(fault=code)

    def emergency(self, code: int, register_bits: int = 1, data: bytes = b"") -> None:
        """Send an EMCY message and go on."""
        self._cause(emergency=Emergency(code=code, register_bits=register_bits, data=list(data)))

    def clear_emergency(self, code: int) -> None:
        """Clear an error (EMCY)."""
        self._cause(emergency_over=code)

    def encoder_jump(self, turns: float) -> None:
        """Make the encoder jump."""
        self._cause(encoder_jump_turns=turns)

    def no_heartbeat(self, duration_s: float) -> None:
        """Send no heartbeat for so long."""
        self._cause(no_heartbeat_s=duration_s)

    def silence(self, duration_s: float) -> None:
        """Send nothing for so long."""
        self._cause(silent_s=duration_s)

    def reset(self) -> None:
        """Reset, as after a dip of its supply."""
        self._cause(reset=True)

    def _cause(self, **what: object) -> None:
        event = Event.model_validate({"at_s": 0.0, **what})
        place = self._nodes.index(self._node) if what.keys() & OF_AN_AXIS else 0
        self._do(lambda: self._application.faulty[place].cause(event))

    def _do(self, what: Callable[[], Result]) -> Result:
        """Do it on the host's thread, between two cycles, and wait for it."""
        done: Future[Result] = Future()

        def act() -> None:
            try:
                done.set_result(what())
            except Exception as error:
                done.set_exception(error)

        self._application.ask(act)
        return done.result(_ANSWER_S)
