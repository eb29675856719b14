"""The hub of the embedded bus: a process of its own that emulates one CAN wire between its clients.

`python -m hilbench.can.hub` is started by the first client (see `hub_client`) with a listening socket; it ends when no
connection is left. Only the standard library is imported here, so that it starts fast and without site-packages; where
many frames go by, `forwarding` is loaded while it serves.

Flow of a frame: client's packet, its station's transmit queue, arbitration and bus time (`medium`), one packet for
every other station that receives some of the frames completed. A station whose transmit queue is full is not read
until there is room: its socket fills up and its sender blocks. A receiver that does not read loses the newest frames,
and gets their number.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import os
import select
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from itertools import islice, takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hilbench.can import protocol, requests
from hilbench.can.confinement import ControllerState
from hilbench.can.disturbance import Disturber, ErrorInjection
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, is_classical
from hilbench.can.medium import FOREVER, Delivery, Listeners, Medium, Station
from hilbench.can.wire import FD_LENGTHS, bits_on_wire, fd_bits_on_wire

if TYPE_CHECKING:
    from hilbench.can.forwarding import Forwarder, Left, Place

#: The hub ends after this time without a connection: time for a program to close one bus and open the next.
GRACE_S = 0.1
#: Frames a station may have waiting for the wire before the hub stops reading from it.
TRANSMIT_LIMIT = 512
#: Frames that wait in the hub for a receiver whose socket is full, before they are dropped.
RECEIVE_LIMIT = 16384
#: Records in one packet to a client.
DELIVERED_RECORDS = 512
#: Frames after which what forwards them without the interpreter is loaded, which takes as much as the interpreter needs
#: for some 20,000.
_FRAMES_UNTIL_LOADED = 4096
#: How long a station waits for the loading thread at most.
_SWITCH_WHILE_LOADING_S = 0.0002
#: Connections at a time; further ones are closed at once.
MAX_CLIENTS = 128


class Client(Station):
    """One connection; a station on the wire once it has joined."""

    def __init__(self, connection: socket.socket, identity: int) -> None:
        super().__init__()
        self.connection = connection
        self.identity = identity
        self.joined = False
        self.filters: requests.Filters = None
        self.receive_own = False
        self.fd = False
        self.limit = DELIVERED_RECORDS  # in one packet
        self.dropped = 0
        self.waiting: deque[bytes] = deque()  # stamped records its socket had no room for
        self.reading = True  # not paused because of its full transmit queue
        self.blocked = False  # epoll reports when its socket has room again


class Hub:
    """The server: one thread, one epoll loop."""

    def __init__(self, channel: str, listener: socket.socket) -> None:
        self.channel = channel
        self.settings = requests.Settings()
        self.malformed = 0
        self._listener = listener
        self._clients: dict[int, Client] = {}  # connected, by file descriptor
        self._departed: list[Client] = []  # left, with frames still to send
        self._listeners = Listeners(lambda: [client for client in self._clients.values() if client.joined])
        self._forwarder: Forwarder | None = None
        self._loads = False
        self._identities = 0
        self._fd = False  # true once a station that may send FD frames has joined
        self._epoll = select.epoll()
        self._epoll.register(listener, select.EPOLLIN)
        self._handlers: dict[str, Callable[..., dict[str, Any]]] = {
            "join": self._join,
            "set_filters": self._set_filters,
            "set_errors": self._set_errors,
            "set_priority": self._set_priority,
            "statistics": self._statistics,
        }
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._medium = Medium(self.settings.bitrate)

    # --- the loop

    def serve(self, may_end: Callable[[], bool]) -> None:
        """Serve until there was no connection for GRACE_S and `may_end()` agrees."""
        idle_since = time.monotonic()
        while True:
            if not self._forward():
                for descriptor, events in self._poll():
                    if descriptor == self._listener.fileno():
                        self._accept()
                    elif descriptor in self._clients:
                        self._attend(self._clients[descriptor], events)
            self._run()
            if self._clients or self._departed:
                idle_since = time.monotonic()
            elif time.monotonic() - idle_since >= GRACE_S:
                if may_end():
                    return
                idle_since = time.monotonic()

    def wake_by(self, descriptor: int) -> None:
        """End the wait when this can be read; it is no client's connection."""
        self._epoll.register(descriptor, select.EPOLLIN)

    def _poll(self) -> list[tuple[int, int]]:
        """Ready descriptors; waits at most until the wire has something to do."""
        event_ns = self._medium.next_event_ns() if self.settings.timing == "real" else None
        if event_ns is not None:
            # epoll waits in whole milliseconds: several frames. select has the resolution.
            wait_s = (event_ns - self._now_ns()) * 1e-9
            if wait_s > 0:
                select.select([self._epoll.fileno()], [], [], wait_s)
            return self._epoll.poll(0)
        return self._epoll.poll(-1 if self._clients else GRACE_S)

    def _now_ns(self) -> int:
        """Bus time of `real` timing: CLOCK_REALTIME when the hub began, never set back or forth since."""
        return time.monotonic_ns() + self._clock_offset_ns

    # --- without the interpreter

    def _forward(self) -> bool:
        """Forward packets of known frames while time is virtual, until something else happens. True if that was handled
        here: a packet, or a station that does not read. False, and nothing done, where there is more to
        do."""
        forwarder = self._forwarder
        if self.settings.timing == "real":
            return False
        if forwarder is None:
            if not self._loads and self._medium.counters.frames >= _FRAMES_UNTIL_LOADED:
                self._load()
            return False
        if not (0 < len(self._medium.stations) <= forwarder.MAX_STATIONS and self._is_quiet()):
            return False
        left = forwarder.forward(self._medium, self._places())
        self._take_left(left)
        return bool(left.packets or left.undelivered)

    def _places(self) -> list[Place]:
        return [(each.connection.fileno(), each.limit, each.dropped, each.receive_own) for each in self._stations]

    @property
    def _stations(self) -> Sequence[Client]:
        return cast("Sequence[Client]", self._medium.stations)

    def _take_left(self, left: Left) -> None:
        """Process packets and records that were not forwarded."""
        stations = list(self._stations)
        for at, packet in left.packets:
            if packet is None:
                self._attend(stations[at], select.EPOLLIN)
            else:
                self._take(stations[at], packet)
        for at, records in left.undelivered:
            self._deliver(stations[at], records)

    def _is_quiet(self) -> bool:
        """True if frames are received as soon as they are sent, without disturbances."""
        if self._departed or not self._medium.undisturbed:
            return False
        return not any(client.blocked or not client.reading for client in self._clients.values())

    def _received_by(self, can_id: int) -> int:
        """Stations that receive an identifier, a bit each."""
        hearing = self._listeners.of(can_id)
        return sum(1 << at for at, client in enumerate(self._medium.stations) if client in hearing)

    def _load(self) -> None:
        """Load what forwards; the stations are served meanwhile."""
        from threading import Thread  # a hub that starts needs none

        self._loads = True
        sys.setswitchinterval(_SWITCH_WHILE_LOADING_S)
        Thread(target=self.load_forwarder).start()

    def load_forwarder(self) -> None:
        """Load the forwarder: from now on packets of known frames need no interpreter."""
        if sys.flags.no_site:  # the hub was started without other packages
            import site

            site.main()
        from hilbench.can.forwarding import Forwarder

        self._forwarder = Forwarder(self._epoll.fileno())

    # --- connections

    def _accept(self) -> None:
        try:
            connection, _ = self._listener.accept()
        except OSError:  # it has left again
            return
        if not protocol.may_join(connection) or len(self._clients) >= MAX_CLIENTS:
            connection.close()
            return
        self.connect(connection)

    def connect(self, connection: socket.socket) -> Client:
        """Serve the client at the other end."""
        connection.setblocking(False)
        self._identities += 1
        client = self._clients[connection.fileno()] = Client(connection, self._identities)
        self._epoll.register(connection, select.EPOLLIN)
        return client

    def _attend(self, client: Client, events: int) -> None:
        if events & select.EPOLLOUT:
            self._flush(client)
        if not client.reading or not events & (select.EPOLLIN | select.EPOLLHUP | select.EPOLLERR):
            return
        try:
            packet = client.connection.recv(protocol.PACKET_BYTES)
        except (BlockingIOError, ConnectionResetError):  # it has left without reading all: its own frames come next
            return
        self._take(client, packet)

    def _take(self, client: Client, packet: bytes) -> None:
        if not packet:
            self._disconnect(client)
        elif client.joined:
            self._take_frames(client, packet)
        else:
            self._answer(client, packet)

    def _disconnect(self, client: Client) -> None:
        descriptor = client.connection.fileno()
        self._epoll.unregister(descriptor)
        del self._clients[descriptor]
        client.connection.close()
        if client.joined:
            self._departed.append(client)
            self._forget_listeners()

    def _watch(self, client: Client) -> None:
        """Set the events that epoll waits for. A paused socket would report its hang-up again and again: edges only."""
        events = select.EPOLLIN if client.reading else select.EPOLLET
        if client.blocked:
            events |= select.EPOLLOUT
        self._epoll.modify(client.connection, events)

    # --- frames in

    def _forget_listeners(self) -> None:
        """Forget receivers: a station has joined or left, or changed its filters."""
        self._listeners.forget()
        if self._forwarder is not None:
            self._forwarder.forget()

    def _take_frames(self, client: Client, packet: bytes) -> None:
        kind = packet[0]
        body = memoryview(packet)[protocol.HEADER.size :]
        record = protocol.FD_RECORD if kind == protocol.KIND_FD else protocol.CAN_RECORD
        known = kind == protocol.KIND_CLASSICAL or (kind == protocol.KIND_FD and client.fd)
        if len(packet) < protocol.HEADER.size or not known or len(body) % record.size:
            self.malformed += 1
            return
        arrival_ns = self._now_ns() if self.settings.timing == "real" else self._medium.free_ns
        queue = self._medium.queue
        start = protocol.HEADER.size
        classical = kind == protocol.KIND_CLASSICAL
        learn = self._forwarder.learn if self._forwarder is not None and classical else None
        for can_id, length, flags, data in record.iter_unpack(body):
            if not classical:
                bits = self._fd_bits(can_id, length, flags, data)
            else:
                bits = bits_on_wire(can_id, data[:length]) if is_classical(can_id, length) else 0
            if bits:
                queue(client, can_id, packet[start : start + record.size], bits, arrival_ns)
                if learn is not None:
                    learn(can_id, length, self._received_by(can_id))
            else:
                self.malformed += 1
            start += record.size
        if len(client.queue) >= TRANSMIT_LIMIT:
            self._pause(client)

    def _fd_bits(self, can_id: int, length: int, flags: int, data: bytes) -> int:
        """Time of an FD record in nominal bit times; 0: no frame that could be on a wire."""
        if length not in FD_LENGTHS or can_id & (ERROR_FLAG | REMOTE_FLAG):
            return 0
        if can_id & 0x1FFFF800 and not can_id & EXTENDED_FLAG:
            return 0
        nominal, fast = fd_bits_on_wire(can_id, data[:length], bool(flags & protocol.BIT_RATE_SWITCH))
        return nominal + -(-fast * self.settings.bitrate // self.settings.data_bitrate)

    def _pause(self, client: Client) -> None:
        client.reading = False
        self._watch(client)

    def _resume(self) -> None:
        """Read again from the stations whose transmit queue has room."""
        for client in self._clients.values():
            if not client.reading and len(client.queue) <= TRANSMIT_LIMIT // 2:
                client.reading = True
                self._watch(client)

    # --- frames out

    def _run(self) -> None:
        """Let the wire carry the frames completed by now (virtual: all), and deliver them."""
        delivered = self._medium.run(self._now_ns() if self.settings.timing == "real" else FOREVER)
        if delivered:
            self._hand_out(delivered)
            self._resume()
        if self._medium.changed:
            self._send_states()
        if self._departed:
            self._forget_departed()

    def _forget_departed(self) -> None:
        """Take stations that left off the wire, once their last frames are sent or there is no receiver for them."""
        if not any(client.joined for client in self._clients.values()):
            for client in self._departed:
                client.queue.clear()
        for client in [client for client in self._departed if not client.queue]:
            self._departed.remove(client)
            self._medium.leave(client)

    def _hand_out(self, delivered: list[Delivery]) -> None:
        """Give every station the frames that are for it; its own ones only on request, and marked."""
        pack_time, listeners_of = protocol.STAMP.pack, self._listeners.of
        records: dict[Client, list[bytes]] = {}
        for sender, can_id, payload, time_ns in delivered:
            record = payload + pack_time(time_ns)
            for client in listeners_of(can_id):
                if client is not sender:
                    records.setdefault(client, []).append(record)
                elif client.receive_own:
                    own = record[:5] + bytes([record[5] | protocol.OWN]) + record[6:]
                    records.setdefault(client, []).append(own)
        for client, selected in records.items():
            if client.state is not ControllerState.BUS_OFF:
                self._deliver(client, selected)

    def _send_states(self) -> None:
        """Send each station the changed state of its own controller, whatever its filters are."""
        changed, self._medium.changed = self._medium.changed, []
        for client in self._clients.values():
            if client in changed:
                can_id, data = client.errors.message()
                record = protocol.CAN_RECORD.pack(can_id, len(data), 0, data)
                self._deliver(client, [record + protocol.STAMP.pack(self._medium.free_ns)])

    def _deliver(self, client: Client, records: list[bytes]) -> None:
        if self._fd and not client.fd:
            records = [record for record in records if len(record) == protocol.STAMPED_CAN_RECORD.size]
        room = RECEIVE_LIMIT - len(client.waiting)
        if len(records) > room:
            client.dropped += len(records) - room
            records = records[:room]
        client.waiting.extend(records)
        if not client.blocked:
            self._flush(client)

    def _flush(self, client: Client) -> None:
        """Send what waits for this client, as far as its socket takes it."""
        waiting = client.waiting
        blocked = False
        while waiting:
            records = self._next_packet(client)
            kind = protocol.KIND_CLASSICAL if len(records[0]) == protocol.STAMPED_CAN_RECORD.size else protocol.KIND_FD
            header = protocol.HEADER.pack(kind, client.dropped & 0xFFFFFFFF)
            try:
                client.connection.send(header + b"".join(records))
            except BlockingIOError:
                blocked = True
                break
            except OSError:  # it has left; the next recv reports it
                waiting.clear()
                break
            if len(records) == len(waiting):
                waiting.clear()
            else:
                for _ in records:
                    waiting.popleft()
        if blocked is not client.blocked:
            client.blocked = blocked
            self._watch(client)

    def _next_packet(self, client: Client) -> list[bytes]:
        """The waiting records that go into the next packet: all of one size."""
        waiting = client.waiting
        records = list(waiting) if len(waiting) <= client.limit else list(islice(waiting, client.limit))
        if not client.fd:
            return records
        size = len(records[0])
        return list(takewhile(lambda record: len(record) == size, records))

    # --- requests

    def _answer(self, client: Client, packet: bytes) -> None:
        try:
            request, arguments = requests.parse(packet)
            reply = self._handlers[request](client, **arguments)
        except requests.RefusedError as error:
            reply = {"error": str(error)}
        try:
            client.connection.send(json.dumps(reply).encode())
        except OSError:  # it did not wait for the answer
            return

    def _set_filters(self, _: Client, station: int, filters: requests.Filters) -> dict[str, Any]:
        """Frames that are over from now on reach the station only if a filter accepts them."""
        for client in self._clients.values():
            if client.joined and client.identity == station:
                client.filters = filters
                self._forget_listeners()
                return {}
        raise requests.RefusedError(f"station {station}: not on this bus")

    def _set_errors(self, _: Client, injection: ErrorInjection) -> dict[str, Any]:
        """Disturb the frames that are queued from now on."""
        self._medium.disturber = Disturber(injection)
        return {}

    def _set_priority(self, _: Client, priority: int) -> dict[str, Any]:
        """Run with this priority of SCHED_FIFO, 1 to 99, from now on."""
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except PermissionError:
            raise requests.RefusedError("SCHED_FIFO is not permitted to its hub") from None
        return {}

    def _join(
        self,
        client: Client,
        wanted: requests.Wanted,
        filters: requests.Filters,
        receive_own: bool,
        fd: bool,
        single: bool,
    ) -> dict[str, Any]:
        """Become a station. `single`: one frame a packet, so that the descriptor is readable while a frame waits."""
        alone = not self._departed and not any(other.joined for other in self._clients.values())
        if alone:  # the first one determines the settings of the bus
            self.settings = wanted.completed()
            self._medium = Medium(self.settings.bitrate, self._now_ns() if self.settings.timing == "real" else 0)
            self.malformed = 0
        else:
            try:
                wanted.check_against(self.settings)
            except requests.RefusedError as error:
                raise requests.RefusedError(
                    f"{error}; on it: {self._programs()}; expected these ended, or of the same bit rate and --pace"
                ) from None
        client.filters = filters
        self._forget_listeners()
        client.receive_own, client.fd = receive_own, fd
        client.limit = 1 if single else DELIVERED_RECORDS
        client.joined = True
        self._fd = (self._fd and not alone) or client.fd
        self._medium.join(client)
        return {"version": protocol.VERSION, "station": client.identity, **asdict(self.settings)}

    def _programs(self) -> str:
        """Programs of the stations, as the kernel knows them."""
        from hilbench.can.claims import command_line  # only where it is needed

        pids = {protocol.peer(client.connection)[0] for client in self._clients.values() if client.joined}
        return ", ".join(f"{command_line(pid) or 'a program'} (process {pid})" for pid in sorted(pids))

    def _statistics(self, _: Client) -> dict[str, Any]:
        real = self.settings.timing == "real"
        return {
            **asdict(self.settings),
            **asdict(self._medium.counters),
            "stations": sum(client.joined for client in self._clients.values()),
            "dropped": sum(client.dropped for client in self._clients.values()),
            "malformed": self.malformed,
            "time_ns": (self._now_ns() if real else self._medium.free_ns) - self._medium.start_ns,
        }


def _end(path: Path, log: Path, lock: int, listener: socket.socket) -> bool:
    """Remove the socket, unless a client is just coming: one that connects or starts a hub holds the lock."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    if select.select([listener], [], [], 0)[0]:  # came before we had the lock
        fcntl.flock(lock, fcntl.LOCK_UN)
        return False
    path.unlink(missing_ok=True)
    log.unlink(missing_ok=True)
    return True


def _detach() -> None:
    """Leave the starter's session and parentage: no terminal signals, and no child that must be waited for."""
    if os.fork():
        os._exit(0)
    os.setsid()
    os.chdir("/")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m hilbench.can.hub", description=__doc__)
    parser.add_argument("--channel", required=True)
    parser.add_argument("--directory", required=True, type=Path)
    parser.add_argument("--listener", required=True, type=int, help="file descriptor of the listening socket")
    options = parser.parse_args(arguments)
    listener = socket.socket(fileno=options.listener)
    path = options.directory / f"{options.channel}.sock"
    log = protocol.log_path(options.directory, options.channel)
    lock = os.open(protocol.lock_path(options.directory), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    _detach()
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        hub = Hub(options.channel, listener)
        # A signal that comes just before the hub waits would be handled after that, which may be never.
        signalled, wakes = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        signal.set_wakeup_fd(wakes)
        hub.wake_by(signalled)
        hub.serve(lambda: _end(path, log, lock, listener))
    except SystemExit:  # terminated: the listening socket is still ours, so no other hub can have taken the place
        path.unlink(missing_ok=True)
        log.unlink(missing_ok=True)
        raise


if __name__ == "__main__":
    main()
