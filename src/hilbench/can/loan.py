"""The wire of the embedded bus, lent to a station: it forwards what all send, until anything but that happens.

Hub and station have the same memory (`wire_memory`) and the same functions. The hub lends only a wire on which nothing
happens that it would have to decide, gives away the descriptors of its ends of the other connections, and waits for
everything else: who comes, asks, ends, or sends something to the hub itself. Then it takes the wire back, under the
lock, between two packets; the station finds that out and goes on by its socket. The other stations notice nothing.
"""

from __future__ import annotations

import array
import contextlib
import os
import select
import socket

import numpy as np

from hilbench.can import forwarding_kernel, loan_kernel, protocol
from hilbench.can.wire_memory import MAX_STATIONS, WireMemory
from hilbench.compiled import TABLE_WIDTH, table_of

#: So long a hub may take to answer; one of another version doesn't.
_TIMEOUT_S = 1.0
_ASKED = protocol.HEADER.pack(protocol.KIND_LOAN, 0)
_RETURNED = protocol.HEADER.pack(protocol.KIND_RETURN, 0)

#: The `table` of a station that has no wire.
NO_WIRE = np.zeros((0, TABLE_WIDTH), np.int64)


class Loan:
    """Has the wire, from the beginning; `table` is for `loan_kernel`. `close` it."""

    def __init__(self, connection: socket.socket, number: int, tables: WireMemory, others: list[int]) -> None:
        """`number`: of the loan; `others`: the hub's ends of the other stations' connections, in their order."""
        self._connection, self._number, self._others = connection, number, others
        self._state = state = tables.state
        own = np.zeros(loan_kernel.OF_OWN, np.int64)
        at = int(state[forwarding_kernel.BORROWER])
        stations = [*others[:at], -1, *others[at:]]
        self._epoll = select.epoll()
        for descriptor in (connection.fileno(), *others):
            self._epoll.register(descriptor, select.EPOLLIN)
        own[loan_kernel.NUMBER], own[loan_kernel.STATION] = number, at
        own[loan_kernel.DESCRIPTOR], own[loan_kernel.EPOLL] = connection.fileno(), self._epoll.fileno()
        of_descriptors = np.full(max(*others, connection.fileno()) + 1, -1)
        of_descriptors[others] = [station for station in range(len(stations)) if station != at]
        events = np.zeros((forwarding_kernel.MAX_READY + 1) * forwarding_kernel.EVENT_WORDS // 2 + 1, np.int64)
        self._kept = [
            own,
            tables.lock,
            state,
            np.array(stations, np.int64),
            of_descriptors,
            tables.stations,
            tables.known,
            events,
            tables.received,
            tables.packets,
            tables.rows,
            tables.carried,
            np.zeros(forwarding_kernel.PACKET_WORDS, np.int64),
            np.zeros(1, np.int64),
        ]
        self.table = table_of(self._kept)

    @property
    def lasts(self) -> bool:
        """Whether the station still has the wire."""
        return bool(self._state[forwarding_kernel.LOAN] == self._number)

    def close(self) -> None:
        """The wire is the hub's."""
        if self.lasts:
            self._state[forwarding_kernel.LOAN] = 0
            with contextlib.suppress(OSError):  # a bus that is lost, as the next use of the link will tell
                self._connection.send(_RETURNED, socket.MSG_DONTWAIT)
        self._epoll.close()
        others, self._others = self._others, []
        for descriptor in others:
            os.close(descriptor)


def ask(connection: socket.socket) -> tuple[Loan | None, list[bytes]]:
    """Ask the hub for the wire: the loan, None where it can't be had, and packets that came before the answer.

    Raises OSError, also BlockingIOError, where the hub takes or sends nothing.
    """
    came: list[bytes] = []
    connection.send(_ASKED, socket.MSG_DONTWAIT)
    poll = select.poll()
    poll.register(connection, select.POLLIN)
    while poll.poll(_TIMEOUT_S * 1e3):
        packet, descriptors = _receive(connection)
        if not packet:
            raise ConnectionResetError
        if packet[0] != protocol.KIND_LOAN:
            came.append(packet)
            continue
        _, number = protocol.HEADER.unpack(packet)
        return _lent(connection, number, descriptors), came
    return None, came


def _lent(connection: socket.socket, number: int, descriptors: list[int]) -> Loan | None:
    """None, and no descriptor left, where the wire is not lent, or this process can't have all of it."""
    with contextlib.ExitStack() as unused:
        for descriptor in descriptors:
            unused.callback(os.close, descriptor)
        if len(descriptors) < 2:
            return None
        tables, others = WireMemory(descriptors[0]), descriptors[1:]
        if len(others) + 1 != tables.state[forwarding_kernel.STATIONS]:
            return None
        loan = Loan(connection, number, tables, others)
        unused.pop_all()
    os.close(descriptors[0])
    return loan


def _receive(connection: socket.socket) -> tuple[bytes, list[int]]:
    descriptors = array.array("i")
    room = socket.CMSG_SPACE((1 + MAX_STATIONS) * descriptors.itemsize)
    flags = socket.MSG_DONTWAIT | socket.MSG_CMSG_CLOEXEC
    packet, ancillary, _, _ = connection.recvmsg(protocol.PACKET_BYTES, room, flags)
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, socket.SCM_RIGHTS):
            descriptors.frombytes(data[: len(data) - len(data) % descriptors.itemsize])
    return packet, list(descriptors)
