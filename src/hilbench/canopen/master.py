"""The master's half of configuration: SDO, NMT and PDO maps through canopen, with errors that name what failed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from canopen.objectdictionary import ODVariable

import canopen
from hilbench.can.python_can import can
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.canopen.identifiers import (
    COB_ID,
    FUNCTION_CODE,
    HEARTBEAT,
    INVALID,
    NMT,
    NO_REMOTE_REQUEST,
    SDO_ANSWER,
    NmtCommand,
)
from hilbench.canopen.pdo import PdoMap
from hilbench.errors import BenchFaultError, BusError

#: How long canopen's thread may go on after `close`.
_NOTIFIER_CYCLE_S = 0.1

#: Of so many contents what was sent and not heard yet is kept, and for so long: a bus in lockstep may stand still.
_SENT_KEPT, _SENT_KNOWN_S = 256, 60.0


@dataclass(frozen=True)
class Identity:
    """1018h of a node."""

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int


@contextmanager
def _bus_errors() -> Iterator[None]:
    try:
        yield
    except can.CanError as error:
        raise BusError(" ".join(str(error).split())) from error


class _LossIsKnown(can.Listener):
    """Ends canopen's thread without words when the bus is lost; `Network.check` says so where the bus is used next."""

    def on_message_received(self, msg: can.Message) -> None:
        """Others listen."""

    def on_error(self, exc: Exception) -> None:
        """python-can would print what nobody takes, and receive again at once, for ever, what somebody does."""
        raise SystemExit

    def stop(self) -> None:
        """Nothing is held."""


class SentFrames:
    """What was sent lately, so that it is known again when it is heard on another connection to the bus."""

    def __init__(self) -> None:
        self._times_s: dict[tuple[int, bytes], list[float]] = {}
        self._lock = threading.Lock()

    def add(self, can_id: int, data: bytes) -> None:
        """It is about to be sent."""
        with self._lock:
            times_s = self._times_s
            key = can_id, data
            times_s[key] = [*times_s.get(key, ()), time.monotonic()][-_SENT_KEPT:]
            if len(times_s) > _SENT_KEPT:  # those were lost, or nobody listened
                del times_s[next(iter(times_s))]

    def take(self, can_id: int, data: bytes) -> bool:
        """Whether a frame that was heard was sent here not long ago; each is known again once."""
        key = can_id, data
        if key not in self._times_s:
            return False
        with self._lock:
            young = [at_s for at_s in self._times_s.pop(key, ()) if time.monotonic() - at_s < _SENT_KNOWN_S]
            if len(young) > 1:
                self._times_s[key] = young[1:]
            return bool(young)


class _Network(canopen.Network):
    """canopen's network that keeps what it sends."""

    def __init__(self, bus: can.BusABC, sent: SentFrames) -> None:
        super().__init__(bus)
        self._sent = sent

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._sent.add(can_id, bytes(data))
        super().send_message(can_id, data, remote)


class Master:
    """canopen's network on a python-can bus; one SDO transfer with a node at a time.

    Raises BenchFaultError, one line with node, object and reason, when a node does not answer or refuses. `sent` is
    what it has put on the bus.
    """

    def __init__(self, bus: can.BusABC, sdo_timeout_s: float = 1.0) -> None:
        self.sent = SentFrames()
        self._network = _Network(bus, self.sent)
        self._network.NOTIFIER_CYCLE = _NOTIFIER_CYCLE_S
        self._network.listeners.append(_LossIsKnown())  # type: ignore[arg-type] # any listener will do
        self._network.connect()
        self._timeout_s = sdo_timeout_s
        self._locks: dict[int, threading.Lock] = {}  # a node that does not answer holds up no other
        self._booted: set[int] = set()
        self._boot_seen = threading.Condition()
        self._names: dict[int, str] = {}

    def add(self, node_id: int, od: canopen.ObjectDictionary, name: str) -> None:
        """Make a node known by its object dictionary; `name` is used in messages."""
        node = self._network.add_node(node_id, od)
        node.sdo.RESPONSE_TIMEOUT = self._timeout_s
        node.sdo.MAX_RETRIES = 1  # one try: canopen counts down to zero before it gives up
        self._names[node_id] = name
        self._locks[node_id] = threading.Lock()
        self._network.subscribe(HEARTBEAT + node_id, self._heartbeat)

    def receive_only_answers(self) -> None:
        """From now on only SDO answers are received: the cyclic traffic is somebody else's to read."""
        bus = self._network.bus
        assert bus is not None, "connected since it was made"
        bus.set_filters([{"can_id": SDO_ANSWER, "can_mask": FUNCTION_CODE, "extended": False}])

    def close(self) -> None:
        """Leave the bus. One that is lost was reported by whoever used it."""
        with suppress(can.CanError):
            self._network.disconnect()

    # -- NMT ---------------------------------------------------------------------------------------------

    def nmt(self, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command to one node, or to all (0). Raises BusError when the bus is lost."""
        with _bus_errors():
            self._network.send_message(NMT, command.to(node_id))

    def _heartbeat(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) == 1:
            with self._boot_seen:
                self._booted.add(can_id - HEARTBEAT)
                self._boot_seen.notify_all()

    def heard_within(self, duration_s: float) -> set[int]:
        """Who sends a heartbeat (or boots) within a time; blocks for so long. Not after `receive_only_answers`."""
        with self._boot_seen:
            before, self._booted = self._booted, set()
        time.sleep(duration_s)
        with self._boot_seen:
            heard = set(self._booted)
            self._booted |= before
        return heard

    def wait_for_boot(
        self, node_ids: Iterable[int], timeout_s: float, check: Callable[[], None] = lambda: None
    ) -> None:
        """Wait until every node was heard (boot-up or heartbeat) or answers an SDO request.

        `check` is called meanwhile and may raise. Raises BenchFaultError naming the nodes that stay silent and
        what was tried.
        """
        waiting = set(node_ids)
        deadline_s = time.monotonic() + timeout_s
        while True:
            with self._boot_seen:
                self._boot_seen.wait(timeout=0.05)
                waiting -= self._booted
            check()
            if not waiting:
                return
            if time.monotonic() > deadline_s:
                break
        silent = [node_id for node_id in sorted(waiting) if not self._answers(node_id)]
        if silent:
            names = ", ".join(f"{self._names[node_id]} (node {node_id})" for node_id in silent)
            raise BenchFaultError(
                f"no answer from {names}: no boot-up or heartbeat within {timeout_s:g} s and "
                f"no answer to an SDO read of 1000h"
            )

    def wait_for_answer(
        self, node_ids: Iterable[int], timeout_s: float, wake: Callable[[], None] = lambda: None
    ) -> None:
        """Ask nodes by SDO until each answers; `wake` is called after each question that was not answered.

        Raises BenchFaultError naming the first that does not answer.
        """
        for node_id in node_ids:
            deadline_s = time.monotonic() + timeout_s
            while not self._answers(node_id):
                if time.monotonic() > deadline_s:
                    raise BenchFaultError(
                        f"no answer from {self._names[node_id]} (node {node_id}) to an SDO read of 1000h "
                        f"within {timeout_s:g} s"
                    )
                wake()

    def _answers(self, node_id: int) -> bool:
        try:
            with self._locks[node_id], _bus_errors():
                self._network[node_id].sdo.upload(0x1000, 0)
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError):
            return False
        return True

    # -- SDO ---------------------------------------------------------------------------------------------

    def sdo_read(self, node_id: int, index: int, sub: int = 0) -> Any:
        """The value of an object, decoded by its EDS type, whose length the answer must have."""
        variable = self._variable(node_id, index, sub)
        kind = data_type(variable.data_type or 0)
        try:
            with self._locks[node_id], _bus_errors():
                data = self._upload(node_id, index, sub, kind.width)
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError) as error:
            raise self._fault(node_id, variable, "reading", error) from error
        try:
            return kind.decode(data)
        except ValueError as error:
            raise BenchFaultError(f"{self._place(node_id, variable)}: reading it: {error}") from error

    def _upload(self, node_id: int, index: int, sub: int, width: int | None) -> bytes:
        """All bytes of the answer: canopen's own `upload` cuts what is longer than the EDS says."""
        client: Any = self._network[node_id].sdo
        with client.open(index, sub, buffering=0) as answer:
            data = bytes(answer.read())
        # Expedited without a size (CiA 301, 7.2.4.3.6, s = 0): four bytes, of which the type's are meant.
        return data[:width] if answer.exp_data is not None and answer.size is None else data

    def sdo_write(self, node_id: int, index: int, value: Any, sub: int = 0) -> None:
        """Write an object, encoded by its EDS type."""
        variable = self._variable(node_id, index, sub)
        try:
            data = data_type(variable.data_type or 0).encode(value)
        except ValueError as error:
            raise BenchFaultError(f"{self._place(node_id, variable)}: writing {value!r} to it: {error}") from error
        try:
            with self._locks[node_id], _bus_errors():
                self._network[node_id].sdo.download(index, sub, data)
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError) as error:
            raise self._fault(node_id, variable, f"writing {value!r} to", error) from error

    def configure(self, node_id: int, writes: Mapping[tuple[int, int], Any]) -> None:
        """Write objects by (index, sub-index) and read each back. Raises BenchFaultError where they differ."""
        for (index, sub), value in writes.items():
            self.sdo_write(node_id, index, value, sub)
            found = self.sdo_read(node_id, index, sub)
            if found != value:
                variable = self._variable(node_id, index, sub)
                raise BenchFaultError(
                    f"{self._place(node_id, variable)}: reads back {found!r}, expected {value!r} as written"
                )

    def identity(self, node_id: int) -> Identity:
        """1018h of a node."""
        return Identity(*(int(self.sdo_read(node_id, 0x1018, sub)) for sub in (1, 2, 3, 4)))

    def has(self, node_id: int, index: int, sub: int = 0) -> bool:
        """Whether the node's EDS has the object."""
        try:
            eds.variable(self._network[node_id].object_dictionary, index, sub)
        except KeyError:
            return False
        return True

    # -- PDOs --------------------------------------------------------------------------------------------

    def write_rpdo(self, node_id: int, number: int, pdo: PdoMap) -> None:
        """Give a node's RPDO its COB-ID, transmission type and map; read back and check."""
        self._write_pdo(node_id, 0x1400 + number - 1, 0x1600 + number - 1, pdo)

    def write_tpdo(self, node_id: int, number: int, pdo: PdoMap) -> None:
        """Give a node's TPDO its COB-ID, transmission type and map; read back and check."""
        self._write_pdo(node_id, 0x1800 + number - 1, 0x1A00 + number - 1, pdo)

    def disable_pdo(self, node_id: int, communication_index: int) -> None:
        """Make a PDO invalid (bit 31 of its COB-ID)."""
        cob_id = int(self.sdo_read(node_id, communication_index, 1))
        self.sdo_write(node_id, communication_index, cob_id | INVALID, 1)

    def _write_pdo(self, node_id: int, communication: int, mapping: int, pdo: PdoMap) -> None:
        """The procedure of CiA 301: PDO invalid, number 0, entries, number, valid."""
        self.disable_pdo(node_id, communication)
        remote = NO_REMOTE_REQUEST if communication >= 0x1800 else 0
        self.sdo_write(node_id, mapping, 0, 0)
        for sub, entry in enumerate(pdo.mapping, 1):
            self.sdo_write(node_id, mapping, entry, sub)
        self.sdo_write(node_id, mapping, len(pdo.mapping), 0)
        self.sdo_write(node_id, communication, pdo.transmission_type, 2)
        self.sdo_write(node_id, communication, pdo.cob_id | remote | INVALID, 1)
        self.sdo_write(node_id, communication, pdo.cob_id | remote, 1)
        self._check_pdo(node_id, communication, mapping, pdo)

    def _check_pdo(self, node_id: int, communication: int, mapping: int, pdo: PdoMap) -> None:
        """What the device now says of the PDO, against what it was given."""
        count = self.sdo_read(node_id, mapping, 0)
        found = [self.sdo_read(node_id, mapping, sub) for sub in range(1, count + 1)]
        place = f"{self._names[node_id]} (node {node_id})"
        if found != pdo.mapping:
            as_text = " ".join(f"{entry:08X}h" for entry in found)
            raise BenchFaultError(
                f"{place}: {mapping:04X}h reads back {as_text or 'empty'}, "
                f"expected {' '.join(f'{entry:08X}h' for entry in pdo.mapping)}"
            )
        cob_id, kind = (int(self.sdo_read(node_id, communication, sub)) for sub in (1, 2))
        if cob_id & (INVALID | COB_ID) != pdo.cob_id or kind != pdo.transmission_type:
            raise BenchFaultError(
                f"{place}: {communication:04X}h reads back COB-ID {cob_id:X}h, transmission type {kind}, "
                f"expected {pdo.cob_id:X}h, {pdo.transmission_type}"
            )

    # -- messages ----------------------------------------------------------------------------------------

    def _variable(self, node_id: int, index: int, sub: int) -> ODVariable:
        try:
            return eds.variable(self._network[node_id].object_dictionary, index, sub)
        except KeyError:
            raise BenchFaultError(
                f"{self._names[node_id]} (node {node_id}): its EDS has no object {index:04X}h sub {sub}"
            ) from None

    def _place(self, node_id: int, variable: ODVariable) -> str:
        return (
            f"{self._names[node_id]} (node {node_id}), {variable.index:04X}h sub {variable.subindex} '{variable.name}'"
        )

    def _fault(self, node_id: int, variable: ODVariable, doing: str, error: Exception) -> BenchFaultError:
        if isinstance(error, canopen.SdoAbortedError):
            reason = f"abort {error.code:08X}h ({canopen.SdoAbortedError.CODES.get(error.code, 'unknown code')})"
        else:
            reason = f"no answer within {self._timeout_s:g} s"
        return BenchFaultError(f"{self._place(node_id, variable)}: {doing} it: {reason}")
