"""The wire where time is real, compiled: what is over, when, and who was first are those of `Medium`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hilbench.can import clocked_kernel, forwarding_kernel, protocol, wire
from hilbench.can.arbitration import priority
from hilbench.can.medium import Medium, Station

_STATIONS = 3
_BITRATE = 1_000_000
#: Two stations may send the same identifier.
_FRAMES = st.tuples(st.sampled_from([0x001, 0x080, 0x185, 0x7FF]), st.binary(max_size=8))
#: What happens: how long after the last (ns, some frames take 50 to 130 µs), who sends, and what.
_EVENTS = st.lists(
    st.tuples(st.integers(0, 400_000), st.integers(0, _STATIONS - 1), st.lists(_FRAMES, max_size=4)), max_size=20
)

Over = list[tuple[int, int, bytes, int]]


class _Reference:
    """A `Medium`, and what its hub does with it."""

    def __init__(self) -> None:
        self.medium = Medium(_BITRATE)
        self._stations = [Station() for _ in range(_STATIONS)]
        for station in self._stations:
            self.medium.join(station)

    def send(self, sender: int, frames: Sequence[tuple[int, bytes]], now_ns: int) -> None:
        for can_id, data in frames:
            bits = wire.bits_on_wire(can_id, data)
            self.medium.queue(self._stations[sender], can_id, data, bits, now_ns)

    def over(self, now_ns: int) -> Over:
        place = self._stations.index
        return [(place(by), can_id, data, at_ns) for by, can_id, data, at_ns in self.medium.run(now_ns)]


class _Compiled:
    """The same by the functions of the kernel; what packets bring is written where the hub receives it."""

    def __init__(self) -> None:
        self.state = np.zeros(forwarding_kernel.OF_STATE, np.int64)
        self.state[forwarding_kernel.BITRATE] = _BITRATE
        self.clock = np.zeros(clocked_kernel.OF_CLOCK, np.int64)
        self.clock[clocked_kernel.SENDER] = -1
        self._queues = np.zeros((_STATIONS, clocked_kernel.OF_QUEUE), np.int64)
        self._queued = np.zeros((_STATIONS * clocked_kernel.ROOM, clocked_kernel.OF_QUEUED), np.int64)
        self._received = np.zeros((1, forwarding_kernel.PACKET_WORDS), np.int64)
        self._known = np.zeros((4, forwarding_kernel.OF_FRAME), np.int64)
        self._carried = np.zeros((forwarding_kernel.MAX_CARRIED, forwarding_kernel.OF_CARRIED), np.int64)

    def send(self, sender: int, frames: Sequence[tuple[int, bytes]], now_ns: int) -> None:
        octets, packets = self._received.view(np.uint8), np.zeros((1, forwarding_kernel.OF_PACKET), np.int64)
        rows = np.arange(4).reshape((1, 4))
        packets[0, forwarding_kernel.STATION], packets[0, forwarding_kernel.FRAMES] = sender, len(frames)
        for at, (can_id, data) in enumerate(frames):
            record = protocol.CAN_RECORD.pack(can_id, len(data), 0, data)
            first = protocol.HEADER.size + at * len(record)
            octets[0, first : first + len(record)] = np.frombuffer(record, np.uint8)
            known = self._known[at]
            header = forwarding_kernel.CRC, forwarding_kernel.STUFFING, forwarding_kernel.BITS
            known[list(header)] = wire.header(can_id, len(data))
            known[forwarding_kernel.DATA_BYTES], known[forwarding_kernel.PRIORITY] = len(data), priority(can_id)
            known[forwarding_kernel.HEARD_BY] = 0b111
        tables = self._known, packets, 1, rows, self._received, octets, self._queues, self._queued
        assert clocked_kernel.queue(self.state, *tables, now_ns)

    def over(self, now_ns: int) -> Over:
        count = clocked_kernel.carry(self.state, self.clock, self._queues, self._queued, now_ns, self._carried)
        found: Over = []
        for row in self._carried[:count]:
            can_id, size, _, data = protocol.CAN_RECORD.unpack(row[:2].tobytes())
            sender = int(0b111 ^ row[forwarding_kernel.TO]).bit_length() - 1  # the only one that does not hear it
            assert row[forwarding_kernel.TO] == 0b111 ^ 1 << sender
            found.append((sender, can_id, data[:size], int(row[forwarding_kernel.TIME_NS])))
        return found


@given(_EVENTS)
def test_frames_wait_compete_and_are_over_as_on_the_medium(events):
    reference, compiled = _Reference(), _Compiled()
    now_ns = 0
    for after_ns, sender, frames in [*events, (1_000_000_000, 0, [])]:
        now_ns += after_ns
        for each in (reference, compiled):
            each.send(sender, frames, now_ns)
        assert compiled.over(now_ns) == reference.over(now_ns)
        state, counters = compiled.state, reference.medium.counters
        assert state[forwarding_kernel.FREE_NS] == reference.medium.free_ns
        assert state[forwarding_kernel.CARRIED_FRAMES] == counters.frames
        assert state[forwarding_kernel.CARRIED_BITS] == counters.bits
        if compiled.clock[clocked_kernel.SENDER] >= 0:
            assert compiled.clock[clocked_kernel.END_NS] == reference.medium.next_event_ns()
    assert reference.medium.undisturbed
