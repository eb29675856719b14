"""Master side of configuration: SDO, NMT and PDO maps through canopen, with errors that name what failed."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from canopen.objectdictionary import ODVariable

import canopen
from hilbench.can.python_can import can
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.canopen.identifiers import COB_ID, HEARTBEAT, INVALID, MAPPING, NMT, NO_REMOTE_REQUEST, NmtCommand
from hilbench.canopen.pdo import PdoMap
from hilbench.canopen.sdo_client import SdoClient, reason_of
from hilbench.errors import BenchFaultError, BusError, one_line


@dataclass(frozen=True)
class Identity:
    """1018h of a node."""

    vendor_id: int
    product_code: int
    revision_number: int
    serial_number: int


class Master(SdoClient):
    """canopen's network on a python-can bus; one SDO transfer with a node at a time.

    Raises BenchFaultError, one line with node, object and reason, when a node does not answer or refuses. `sent` is
    what it has put on the bus, `written` what was last written to each object, by node id, index and sub-index.
    """

    def __init__(self, bus: can.BusABC, sdo_timeout_s: float = 1.0) -> None:
        super().__init__(bus, sdo_timeout_s)
        self._booted: set[int] = set()
        self._boot_seen = threading.Condition()
        self._names: dict[int, str] = {}
        self.written: dict[tuple[int, int, int], bytes] = {}

    def add(self, node_id: int, od: canopen.ObjectDictionary, name: str) -> None:
        """Make a node known by its object dictionary; `name` is used in messages."""
        self._add(node_id, od)
        self._names[node_id] = name
        self._network.subscribe(HEARTBEAT + node_id, self._heartbeat)

    # -- NMT ---------------------------------------------------------------------------------------------

    def nmt(self, command: NmtCommand, node_id: int = 0) -> None:
        """Send an NMT command to one node, or to all (0). Raises BusError when the bus is lost."""
        try:
            self._network.send_message(NMT, command.to(node_id))
        except can.CanError as error:
            raise BusError(one_line(error)) from error

    def _heartbeat(self, can_id: int, data: bytearray, timestamp: float) -> None:
        if len(data) == 1:
            with self._boot_seen:
                self._booted.add(can_id - HEARTBEAT)
                self._boot_seen.notify_all()

    def responding_within(self, duration_s: float) -> set[int]:
        """Nodes that send a heartbeat (or boot) within a time; blocks for so long. Not after `receive_only_answers`."""
        with self._boot_seen:
            before, self._booted = self._booted, set()
        time.sleep(duration_s)
        with self._boot_seen:
            received = set(self._booted)
            self._booted |= before
        return received

    def wait_for_boot(
        self,
        node_ids: Iterable[int],
        timeout_s: float,
        check: Callable[[], None] = lambda: None,
        *,
        beside: Iterable[int] = (),
    ) -> None:
        """Wait until every node has sent boot-up or heartbeat, or answers an SDO request.

        `check` is called meanwhile and may raise. Raises BenchFaultError naming the nodes that stay silent, also those
        in `beside`, which are not waited for, and what was tried.
        """
        waiting = set(node_ids)
        deadline_s = time.monotonic() + timeout_s
        while True:
            check()
            with self._boot_seen:
                if waiting <= self._booted:
                    return
                if time.monotonic() > deadline_s:
                    unheard = waiting.union(beside) - self._booted
                    break
                self._boot_seen.wait(timeout=0.05)
        silent = [node_id for node_id in sorted(unheard) if not self._answers(node_id)]
        if not waiting.isdisjoint(silent):
            names = ", ".join(f"{self._names[node_id]} (node {node_id})" for node_id in silent)
            raise BenchFaultError(
                f"no answer from {names}: no boot-up or heartbeat within {timeout_s:g} s and "
                f"no answer to an SDO read of 1000h"
            )

    def wait_for_answer(
        self, node_ids: Iterable[int], timeout_s: float, wake: Callable[[], None] = lambda: None
    ) -> None:
        """Read from nodes by SDO until each answers; `wake` is called after each read without an answer.

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
        return isinstance(self.read(node_id, 0x1000), bytes)

    # -- SDO ---------------------------------------------------------------------------------------------

    def sdo_read(self, node_id: int, index: int, sub: int = 0) -> Any:
        """The value of an object, decoded by its EDS type, whose length the answer must have."""
        variable = self._variable(node_id, index, sub)
        kind = data_type(variable.data_type or 0)
        try:
            data = self.upload(node_id, index, sub, kind.width)
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError) as error:
            raise self._fault(node_id, variable, "reading", error) from error
        try:
            return kind.decode(data)
        except ValueError as error:
            raise BenchFaultError(f"{self._place(node_id, variable)}: reading it: {error}") from error

    def sdo_write(self, node_id: int, index: int, value: Any, sub: int = 0) -> None:
        """Write an object, encoded by its EDS type."""
        variable = self._variable(node_id, index, sub)
        try:
            data = data_type(variable.data_type or 0).encode(value)
        except ValueError as error:
            raise BenchFaultError(f"{self._place(node_id, variable)}: writing {value!r} to it: {error}") from error
        try:
            self.download(node_id, index, sub, data)
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError) as error:
            raise self._fault(node_id, variable, f"writing {value!r} to", error, self._time_out_s(index)) from error
        self.written[node_id, index, sub] = data

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
        """True if the node's EDS has the object."""
        return eds.known(self._network[node_id].object_dictionary, index, sub) is not None

    # -- PDOs --------------------------------------------------------------------------------------------

    def disable_pdo(self, node_id: int, communication_index: int) -> None:
        """Make a PDO invalid (bit 31 of its COB-ID); one whose COB-ID is read-only carries nothing."""
        if self._variable(node_id, communication_index, 1).writable:
            cob_id = int(self.sdo_read(node_id, communication_index, 1))
            self.sdo_write(node_id, communication_index, cob_id | INVALID, 1)
        else:
            self._give(node_id, communication_index + MAPPING, 0, 0)

    def _give(self, node_id: int, index: int, value: int, sub: int) -> None:
        """Write it, unless it is read-only by its EDS: reading it back afterwards shows its value."""
        if self._variable(node_id, index, sub).writable:
            self.sdo_write(node_id, index, value, sub)

    def write_pdo(self, node_id: int, pdo: PdoMap) -> None:
        """Give a node's PDO its COB-ID, transmission type and map; read back and check.

        The procedure of CiA 301: PDO invalid, number 0, entries, number, valid.
        """
        communication, mapping = pdo.communication, pdo.communication + MAPPING
        self.disable_pdo(node_id, communication)
        remote = NO_REMOTE_REQUEST if communication >= 0x1800 else 0
        self._give(node_id, mapping, 0, 0)
        for sub, entry in enumerate(pdo.mapping, 1):
            self._give(node_id, mapping, entry, sub)
        self._give(node_id, mapping, len(pdo.mapping), 0)
        self._give(node_id, communication, pdo.transmission_type, 2)
        self._give(node_id, communication, pdo.cob_id | remote | INVALID, 1)
        self._give(node_id, communication, pdo.cob_id | remote, 1)
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
        found = eds.known(self._network[node_id].object_dictionary, index, sub)
        if found is None:
            raise BenchFaultError(
                f"{self._names[node_id]} (node {node_id}): its EDS has no object {index:04X}h sub {sub}"
            )
        return found

    def _place(self, node_id: int, variable: ODVariable) -> str:
        return (
            f"{self._names[node_id]} (node {node_id}), {variable.index:04X}h sub {variable.subindex} '{variable.name}'"
        )

    def _fault(
        self, node_id: int, variable: ODVariable, doing: str, error: Exception, time_out_s: float | None = None
    ) -> BenchFaultError:
        reason = reason_of(error, time_out_s or self.timeout_s)
        return BenchFaultError(f"{self._place(node_id, variable)}: {doing} it: {reason}")
