"""The bus of a bench by the clock, and the nodes on it, as a script: packet by packet, and SYNC is out when the script
says so. What a script may change in a cycle stands below."""

from __future__ import annotations

import socket
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from hilbench.can import protocol
from hilbench.can.frame import Frame
from hilbench.can.waiting import wait_readable
from hilbench.canopen.identifiers import HEARTBEAT, SYNC
from hilbench.exchange.nodes import Nodes

ENABLED, FAULT = 0x27, 0x08
EPOCH_NS = 1_700_000_000_000_000_000  #: of the first time stamp
_LONG_NS = 10_000_000_000
_FRAME_NS = 130_000  # from one time stamp to the next
_NODE_IDS = (1, 2, 3, 17, 18, 32)
_DATA = {"axis1": 11, "axis2": -7, "load": 3}  #: what the drives answer goes by these

Packets = list[list[Frame]]


@dataclass
class Script:
    """What the bench hears in a cycle: packets before SYNC, that in which SYNC is with what is behind it, and those
    that come later; `gone_by`: SYNCs, with their answers, that are out before the bench comes, the last of which it may
    join; `in_time`: else the time for answers is over at once; `lost`: frames that the bus has dropped by then."""

    before: Packets
    with_sync: list[Frame]
    later: Packets = field(default_factory=list)
    gone_by: Packets = field(default_factory=list)
    joins: bool = False
    in_time: bool = True
    lost: int = 0


Change = Callable[["Bus", int, Script], None]


class Bus:
    """The other end of the bench's socket, and what the nodes on it say."""

    def __init__(self, nodes: Nodes, changes: Sequence[tuple[int, Change]]) -> None:
        self.ours, self._theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.ours.setblocking(False)
        self._theirs.setblocking(False)
        self.nodes, self._changes = nodes, changes
        self.sent: list[str] = []
        self.held_back: list[Frame] = []  #: what comes before the next SYNC only
        self.withheld = 0  #: answers that stay away, or come late
        self.silent: set[int] = set()  #: nodes that send no heartbeats
        self._syncs = self.count = 0  #: that were out, and that the twin has counted
        self.statuswords = dict.fromkeys(_DATA, ENABLED)
        self._stamp_ns, self.lost = EPOCH_NS, 0

    def answers(self) -> list[Frame]:
        """Of all nodes to one SYNC."""
        self.count += 1
        self._syncs += 1
        found, io = [], self.nodes.io
        for part, value in _DATA.items():
            tpdos = self.nodes.pdo_maps(part)[1:]
            found.append(Frame(tpdos[0].cob_id, tpdos[0].pack((self.statuswords[part], value + self.count, value))))
            found += [Frame(pdo.cob_id, pdo.pack((value * self.count,))) for pdo in tpdos[1:]]
        for pdo in io.sent:
            if self._syncs % pdo.period:
                continue
            found.append(Frame(pdo.cob_id, pdo.pack([0.5 * self.count + k for k in range(len(pdo.kinds))])))
        return [*found, Frame(io.status.cob_id, io.status.pack((self.count & 0xFFFF, 0, 3)))]

    def script(self, cycle: int) -> Script:
        """Of this cycle: heartbeats now and then, some before SYNC."""
        alive = [
            Frame(HEARTBEAT + node_id, b"\x05")
            for node_id in _NODE_IDS
            if (cycle + node_id) % 7 == 0 and node_id not in self.silent
        ]
        before = [self.held_back] if self.held_back else []
        self.held_back = []
        if cycle % 2 and alive:
            before.append(alive)
        script = Script(before, [Frame(SYNC, b""), *self.answers()])
        if alive and not cycle % 2:
            script.with_sync[3:3] = alive
        for at, change in self._changes:
            if at == cycle:
                change(self, cycle, script)
        return script

    def deliver(self, packets: Packets) -> None:
        for frames in packets:
            records = b""
            for frame in frames:
                self._stamp_ns += _FRAME_NS
                data = frame.data.ljust(8, b"\0")
                records += protocol.STAMPED_CAN_RECORD.pack(frame.can_id, len(frame.data), 0, data, self._stamp_ns)
            self._theirs.send(protocol.HEADER.pack(protocol.KIND_CLASSICAL, self.lost) + records)

    def take(self, timeout_s: float = 0.0) -> list[Frame]:
        """What the bench has sent since the last call, or within a time; it is kept."""
        found: list[Frame] = []
        while wait_readable(self._theirs.fileno(), timeout_s):
            packet, timeout_s = self._theirs.recv(protocol.PACKET_BYTES), 0.0
            if not packet:
                break
            for can_id, size, _, data in protocol.CAN_RECORD.iter_unpack(packet[protocol.HEADER.size :]):
                found.append(Frame(can_id, data[:size]))
        self.sent += [f"{frame.can_id:03X}#{frame.data.hex()}" for frame in found]
        return found

    @property
    def has_something(self) -> bool:
        """Whether the bench has sent more."""
        return wait_readable(self._theirs.fileno(), 0.0)

    def close(self) -> None:
        self.ours.close()
        self._theirs.close()


class Producer:
    """Sends SYNC when the bench has said that it is there, and waits: see `SyncProducer`."""

    period_ns = 2_000_000
    is_running = True

    def __init__(self, bus: Bus) -> None:
        self.sent = self.without = 0
        self.next_ns_now = 0
        self._bus, self._cycle = bus, 0
        self._script: Script | None = None

    def go_on(self) -> None:
        self._bus.take()
        script = self._script = self._bus.script(self._cycle)
        self._cycle += 1
        self._bus.lost = script.lost or self._bus.lost
        self.sent += len(script.gone_by)
        self._bus.deliver(script.gone_by)

    @property
    def next_ns(self) -> int:
        """What the bench looks at last before it waits."""
        script, self._script = self._script, None
        if script is None:
            return self.next_ns_now
        now_ns = time.monotonic_ns()
        self.next_ns_now = now_ns + _LONG_NS if script.in_time else now_ns
        if script.joins:
            return now_ns + _LONG_NS
        self.sent += 1
        self._bus.deliver([*script.before, script.with_sync, *script.later])
        return now_ns

    def tell_lateness(self, to: array[int]) -> None:
        to.append(0)

    def check(self, waited_s: float) -> None:
        raise AssertionError(f"waited {waited_s} s for SYNC")


class Answering(threading.Thread):
    """The same where the bench sends SYNC itself: what is before it comes when its set points are there."""

    def __init__(self, bus: Bus) -> None:
        super().__init__(daemon=True)
        self._bus = bus
        self.end = threading.Event()
        self.was_late = False  #: SYNC was out before what is to come before it

    def run(self) -> None:
        """Until the `end`."""
        cycle, script = 0, None
        while not self.end.is_set():
            frames = self._bus.take(0.01)
            self.was_late |= script is None and Frame(SYNC, b"") in frames
            for frame in frames:
                if script is None:
                    script = self._bus.script(cycle)
                    self._bus.deliver(script.before)
                    self.was_late |= self._bus.has_something
                if frame.can_id == SYNC:
                    self._bus.deliver([script.with_sync[1:], *script.later])
                    cycle, script = cycle + 1, None


# -- what comes between ----------------------------------------------------------------------------------------------


def _without(bus: Bus, script: Script, cob_id: int) -> Frame:
    """An answer stays away."""
    frame = next(frame for frame in script.with_sync if frame.can_id == cob_id)
    script.with_sync.remove(frame)
    script.in_time = False
    bus.withheld += 1
    return frame


def misses(cob_id: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        _without(bus, script, cob_id)

    return change


def comes_late(cob_id: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.held_back.append(_without(bus, script, cob_id))

    return change


def hears(*frames: Frame, at: int = 4) -> Change:
    """Behind SYNC."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        script.with_sync[at:at] = frames

    return change


def hears_before(*frames: Frame) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        script.before.append(list(frames))

    return change


def in_packets(bus: Bus, cycle: int, script: Script) -> None:
    """The answers one by one."""
    script.later, script.with_sync = [[frame] for frame in script.with_sync[2:]], script.with_sync[:2]


def goes_by(syncs: int, *, joins: bool) -> Change:
    """So many SYNCs are out when the bench comes."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        found = [script.with_sync, *([Frame(SYNC, b""), *bus.answers()] for _ in range(syncs - joins))]
        script.gone_by, script.joins = found[:syncs], joins
        if not joins:
            script.with_sync = found[-1]

    return change


def counts(by: int) -> Change:
    """The twin has counted SYNCs otherwise from now on."""

    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.count += by

    return change


def says(part: str, statusword: int) -> Change:
    def change(bus: Bus, cycle: int, script: Script) -> None:
        bus.statuswords[part] = statusword

    return change


def falls_silent(bus: Bus, cycle: int, script: Script) -> None:
    bus.silent.add(2)


def loses(bus: Bus, cycle: int, script: Script) -> None:
    """The bus has dropped frames for the bench."""
    script.lost = 3


def cut_short(bus: Bus, cycle: int, script: Script) -> None:
    frame = script.with_sync[2]
    script.with_sync[2] = frame._replace(data=frame.data[:-1])
    script.in_time = False  # it is no answer
    bus.withheld += 1


def once_more(bus: Bus, cycle: int, script: Script) -> None:
    script.with_sync.append(script.with_sync[2])


def changed_once_more(bus: Bus, cycle: int, script: Script) -> None:
    frame = script.with_sync[2]
    script.with_sync.append(frame._replace(data=bytes(8)))
