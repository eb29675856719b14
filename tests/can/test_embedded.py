"""The embedded bus through its links: several stations, several processes, what goes wrong on the wire."""

from __future__ import annotations

import itertools
import threading
import time
from typing import Any

import pytest
from tests.can.embedded_links import VIRTUAL, Start, collect, received

from hilbench.can import hub_client
from hilbench.can.confinement import ControllerState
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.hub import RECEIVE_LIMIT
from hilbench.can.open import BusAddress, open_link
from hilbench.can.wire import frame_bits
from hilbench.errors import BusError

#: COB-ID whose frames are broken off by the tests of the error counters.
NOISY = 0x155


ECHO = """
import sys
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
link = open_link(BusAddress(timing=sys.argv[1]))
link.send([Frame(0x700, b"up")])
while True:
    for frame in link.receive(10.0):
        if frame.can_id == 0x7FF:
            sys.exit()
        link.send([frame._replace(can_id=frame.can_id + 1)])
"""


def test_everybody_else_hears_a_batch_in_order(runtime: Any, address: BusAddress) -> None:
    sender, *others = [open_link(address) for _ in range(3)]
    sent = [Frame(0x300, b"\x01\x02"), Frame(0x100, b""), Frame(0x200 | REMOTE_FLAG, bytes(4))]
    sent.append(Frame(0x1ABCDEF | EXTENDED_FLAG, bytes(range(8))))
    sender.send(sent)
    for link in others:
        assert received(collect(link, 4)) == received(sent)
    assert sender.receive(0.0) == []
    for link in (sender, *others):
        link.close()
        link.close()


def test_bus_time_is_the_time_of_the_bits(runtime: Any) -> None:
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)
    sent = [Frame(n, bytes([n] * 8)) for n in range(50)]
    a.send(sent)
    times = [frame.time_ns for frame in collect(b, 50)]
    expected, total = [], 0
    for frame in sent:
        total += frame_bits(frame) * 1000
        expected.append(total)
    assert times == expected
    statistics = hub_client.statistics(VIRTUAL.channel)
    assert (statistics.frames, statistics.bits * 1000, statistics.load) == (50, total, 1.0)
    a.close()
    b.close()


def test_real_timing_takes_the_time_of_the_bits(runtime: Any) -> None:
    """At 100 kbit/s 100 frames last over a tenth of a second: never less, and (stamped) exactly back to back."""
    slow = BusAddress(bitrate=100_000)
    a, b = open_link(slow), open_link(slow)
    sent = [Frame(0x100, b"\x55" * 8)] * 100
    began = time.monotonic_ns()
    a.send(sent)
    times = [frame.time_ns for frame in collect(b, 100)]
    took = time.monotonic_ns() - began
    frame_ns = frame_bits(sent[0]) * 10_000
    assert [after - before for before, after in itertools.pairwise(times)] == [frame_ns] * 99
    assert 1.0 <= took / (100 * frame_ns) < 3.0
    assert abs(times[0] - time.time_ns()) < 20e9
    a.close()
    b.close()


def test_waiting_frames_of_several_stations_compete(runtime: Any) -> None:
    """While one long burst is on the wire, others queue: what follows is in the order of identifiers."""
    slow = BusAddress(bitrate=20_000)
    blocker, one, two, listener = [open_link(slow) for _ in range(4)]
    blocker.send([Frame(0x7FE, bytes(8))])  # 6 ms
    one.send([Frame(0x300, b""), Frame(0x301, b"")])
    two.send([Frame(0x200, b""), Frame(0x400, b"")])
    assert [frame.can_id for frame in collect(listener, 5)] == [0x7FE, 0x200, 0x300, 0x301, 0x400]
    for link in (blocker, one, two, listener):
        link.close()


def test_filters_act_when_the_call_returns(runtime: Any, address: BusAddress) -> None:
    a, b = open_link(address), open_link(address)
    steps: list[tuple[list[tuple[int, int]] | None, list[int]]] = [
        ([(0x180, 0x780)], [0x181]),
        ([], []),
        ([(0x80, 0x7FF), (0x123 | EXTENDED_FLAG, 0x1FFFFFFF | EXTENDED_FLAG)], [0x80, 0x123 | EXTENDED_FLAG]),
        (None, [0x80, 0x123, 0x181, 0x123 | EXTENDED_FLAG]),
    ]
    for done, (filters, expected) in enumerate(steps, 1):
        b.set_filters(filters)
        a.send([Frame(can_id, b"") for can_id in (0x80, 0x123, 0x181, 0x123 | EXTENDED_FLAG)])
        assert [frame.can_id for frame in collect(b, len(expected))] == expected
        # All four pass under these filters.
        assert runtime.eventually(lambda done=done: hub_client.statistics(address.channel).frames == 4 * done)
    a.close()
    b.close()


def test_processes_talk_and_descriptors_tell(runtime: Any, start: Start, address: BusAddress) -> None:
    link = open_link(address)
    child = start(ECHO, address.timing)
    assert received(collect(link, 1)) == [(0x700, b"up")]
    for n in range(20):
        link.send([Frame(0x100 + 2 * n, bytes([n]))])
        assert received(collect(link, 1)) == [(0x101 + 2 * n, bytes([n]))]
    link.send([Frame(0x7FF, b"")])
    assert child.wait(20) == 0
    link.close()


def test_frames_of_who_has_left_still_arrive(runtime: Any) -> None:
    slow = BusAddress(bitrate=100_000)
    a, b = open_link(slow), open_link(slow)
    a.send([Frame(n, bytes(8)) for n in range(20)])
    a.close()
    assert [frame.can_id for frame in collect(b, 20)] == list(range(20))
    b.close()


def test_a_flood_blocks_its_sender(runtime: Any) -> None:
    """The hub reads no more than it can queue: a sender waits for the wire, and everything arrives in order."""
    fast = BusAddress(bitrate=1_000_000)
    a, b = open_link(fast), open_link(fast)
    total = 3000
    frames: list[Frame] = []
    reader = threading.Thread(target=lambda: frames.extend(collect(b, total)))
    reader.start()
    for n in range(total):
        a.send([Frame(0x100, n.to_bytes(4, "big"))])
    still_queued = total - hub_client.statistics(fast.channel).frames
    reader.join()
    assert [int.from_bytes(frame.data, "big") for frame in frames] == list(range(total))
    assert still_queued < total // 2  # the hub's transmit queue, and what the socket between holds
    assert (a.dropped, b.dropped) == (0, 0)
    a.close()
    b.close()


def test_who_does_not_read_loses_the_newest_and_is_told(runtime: Any) -> None:
    a, deaf, awake = [open_link(VIRTUAL) for _ in range(3)]
    awake.set_filters([(0x7FF, 0x7FF)])
    total = 4 * RECEIVE_LIMIT
    for n in range(0, total, 128):
        a.send([Frame(0x100, k.to_bytes(4, "big")) for k in range(n, n + 128)])
    a.send([Frame(0x7FF, b"")])
    assert collect(awake, 1)
    lost = hub_client.statistics(VIRTUAL.channel).dropped
    assert lost > 0
    kept = collect(deaf, total + 1 - lost)
    assert [int.from_bytes(frame.data, "big") for frame in kept] == list(range(len(kept)))
    assert len(kept) == total + 1 - lost
    assert deaf.dropped == lost
    assert awake.dropped == 0
    for link in (a, deaf, awake):
        link.close()


def test_disturbances_on_request(runtime: Any) -> None:
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)

    def arrivals() -> list[int]:
        hub_client.inject_errors(VIRTUAL.channel, ErrorInjection(seed=5, lost=0.3, corrupted=0.1, duplicated=0.1))
        a.send([Frame(0x100, bytes([n])) for n in range(100)])
        hub_client.inject_errors(VIRTUAL.channel, ErrorInjection())
        a.send([Frame(0x7FF, b"")])
        frames: list[Frame] = []
        while not frames or frames[-1].can_id != 0x7FF:
            frames += collect(b, 1)
        return [frame.data[0] for frame in frames[:-1]]

    first = arrivals()
    statistics = hub_client.statistics(VIRTUAL.channel)
    assert first == sorted(first)
    assert statistics.lost == 100 - len(set(first)) > 0
    assert len(first) > len(set(first))
    assert statistics.error_frames > 0
    assert arrivals() == first
    a.close()
    b.close()


def test_a_link_refuses_what_no_wire_carries(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    for can_id, data in ((0x800, b""), (0x123, bytes(9)), (0x20000001, b""), (0x800 | REMOTE_FLAG, b"")):
        with pytest.raises(ValueError, match=f"0x{can_id:X}"):
            link.send([Frame(can_id, data)])
    link.close()


def test_channels_do_not_hear_each_other(runtime: Any) -> None:
    here, there = open_link(BusAddress("embedded", "here", timing="virtual")), open_link(VIRTUAL)
    here.send([Frame(0x1, b"")])
    assert runtime.eventually(lambda: hub_client.statistics("here").frames == 1)
    assert there.receive(0.0) == []
    assert hub_client.running_channels() == ["here", "hilbench0"]
    here.close()
    there.close()


def test_a_station_is_told_that_it_is_bus_off(runtime: Any) -> None:
    """As ISO 11898-1 has it; only who sends is off, and joining anew is a restart."""
    sender, other = open_link(VIRTUAL), open_link(VIRTUAL)
    hub_client.inject_errors(VIRTUAL.channel, ErrorInjection(corrupted=1.0, filters=((NOISY, 0x7FF),)))
    sender.set_filters([(0x7FF, 0x7FF)])  # what its own controller does is told whatever the filters are
    sender.send([Frame(NOISY, b"")])
    with pytest.raises(BusError, match="our controller is bus off"):
        sender.receive(5.0)
    with pytest.raises(BusError, match="our controller is bus off"):
        sender.receive(0.0)
    assert other.receive(0.0) == []
    assert other.controller is ControllerState.ERROR_ACTIVE
    sender.close()
    again = open_link(VIRTUAL)
    again.send([Frame(0x100, b"back")])
    assert [frame.data for frame in collect(other, 1)] == [b"back"]
    for link in (again, other):
        link.close()


def test_a_listener_of_many_broken_frames_is_error_passive(runtime: Any) -> None:
    sender, listener = open_link(VIRTUAL), open_link(VIRTUAL)
    hub_client.inject_errors(VIRTUAL.channel, ErrorInjection(seed=1, corrupted=0.9, filters=((NOISY, 0x7FF),)))
    stations = [sender]
    for _ in range(40):  # whoever goes off is replaced
        try:
            stations[-1].send([Frame(NOISY, b"")])
            listener.receive(0.01)
            stations[-1].receive(0.0)
        except BusError:
            stations.append(open_link(VIRTUAL))
        if listener.controller is ControllerState.ERROR_PASSIVE:
            break
    assert listener.controller is ControllerState.ERROR_PASSIVE
    hub_client.inject_errors(VIRTUAL.channel, ErrorInjection())
    stations.append(open_link(VIRTUAL))  # the last one may have gone off meanwhile
    stations[-1].send([Frame(0x100, b"")] * 200)
    assert len(collect(listener, 200)) >= 200
    listener.receive(0.05)
    assert listener.controller is ControllerState.ERROR_ACTIVE
    for link in (*stations, listener):
        link.close()
