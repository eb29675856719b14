"""The embedded bus through its links: several stations, several processes, what goes wrong."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from hilbench.can import hub_client, protocol
from hilbench.can.claims import MASTER, claim
from hilbench.can.confinement import ControllerState
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.hub import RECEIVE_LIMIT
from hilbench.can.link import Link
from hilbench.can.open import BusAddress, open_link, starting
from hilbench.can.requests import Wanted
from hilbench.can.wire import frame_bits
from hilbench.errors import BusError, UnusableInputError

VIRTUAL = BusAddress(timing="virtual")
REAL = BusAddress()

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


#: Joins, says so once, and listens.
LISTENER = """
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
link = open_link(BusAddress(timing="virtual"))
link.send([Frame(0x700, b"up")])
while True:
    link.receive(10.0)
"""


def collect(link: Link, count: int) -> list[Frame]:
    """`count` frames from a link (fewer if they do not come)."""
    frames: list[Frame] = []
    deadline = time.monotonic() + 20
    while len(frames) < count and time.monotonic() < deadline:
        frames += link.receive(1.0)
    return frames


def heard(frames: list[Frame]) -> list[tuple[int, bytes]]:
    return [(frame.can_id, frame.data) for frame in frames]


Start = Callable[..., "subprocess.Popen[bytes]"]


@pytest.fixture
def start(runtime: Any) -> Iterator[Start]:
    """Run a program in a process of its own; ended with the test."""
    children: list[subprocess.Popen[bytes]] = []

    def start(code: str, *arguments: str) -> subprocess.Popen[bytes]:
        children.append(subprocess.Popen([sys.executable, "-c", code, *arguments]))
        return children[-1]

    yield start
    for child in children:
        child.kill()
        child.wait()


@pytest.fixture(params=["virtual", "real"])
def address(request: pytest.FixtureRequest) -> BusAddress:
    return BusAddress(timing=request.param)


def test_everybody_else_hears_a_batch_in_order(runtime: Any, address: BusAddress) -> None:
    sender, *others = [open_link(address) for _ in range(3)]
    sent = [Frame(0x300, b"\x01\x02"), Frame(0x100, b""), Frame(0x200 | REMOTE_FLAG, bytes(4))]
    sent.append(Frame(0x1ABCDEF | EXTENDED_FLAG, bytes(range(8))))
    sender.send(sent)
    for link in others:
        assert heard(collect(link, 4)) == heard(sent)
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
    assert heard(collect(link, 1)) == [(0x700, b"up")]
    for n in range(20):
        link.send([Frame(0x100 + 2 * n, bytes([n]))])
        assert heard(collect(link, 1)) == [(0x101 + 2 * n, bytes([n]))]
    link.send([Frame(0x7FF, b"")])
    assert child.wait(20) == 0
    link.close()


def test_many_starters_find_one_hub(runtime: Any) -> None:
    links: list[Link] = []
    threads = [threading.Thread(target=lambda: links.append(open_link(VIRTUAL))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(runtime.hubs()) == 1
    links[0].send([Frame(0x1, b"")])
    assert all(collect(link, 1) for link in links[1:])
    for link in links:
        link.close()


def test_a_hub_that_was_started_ahead_is_the_one_that_is_joined(runtime: Any) -> None:
    with starting(REAL):
        assert runtime.hubs()
        with closing(open_link(VIRTUAL)) as link:  # who joins first says how time goes
            assert runtime.eventually(lambda: len(runtime.hubs()) == 1)  # who has started it is gone
            (hub,) = runtime.hubs()
            assert hub_client.statistics(VIRTUAL.channel).stations == 1
            link.send([Frame(0x1, b"")])
        with starting(VIRTUAL):
            assert runtime.hubs() == [hub]
    assert runtime.eventually(lambda: not runtime.hubs())


def test_what_keeps_a_hub_from_starting_is_told_to_who_joins(runtime: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with (
        starting(VIRTUAL),
        pytest.raises(BusError, match="embedded bus hilbench0: its hub did not start: no output"),
    ):
        open_link(VIRTUAL)
    protocol.log_path(runtime.folder, VIRTUAL.channel).unlink()


def test_killed_clients_leave_no_hub(runtime: Any, start: Start) -> None:
    children = [start(LISTENER) for _ in range(3)]
    assert runtime.eventually(lambda: hub_client.running_channels() == [VIRTUAL.channel])
    assert runtime.eventually(lambda: hub_client.statistics(VIRTUAL.channel).stations == 3)
    for child in children:
        child.kill()
        child.wait()
    assert runtime.eventually(lambda: not runtime.hubs())
    assert hub_client.running_channels() == []


def test_others_go_on_when_one_is_killed(runtime: Any, start: Start) -> None:
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)
    child = start(LISTENER)
    assert collect(a, 1)
    assert collect(b, 1)
    child.kill()
    child.wait()
    a.send([Frame(0x1, b"")])
    assert [frame.can_id for frame in collect(b, 1)] == [0x1]
    a.close()
    b.close()


def test_a_hub_that_is_killed_is_a_lost_bus_and_its_socket_file_no_obstacle(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    (hub,) = runtime.hubs()
    os.kill(hub, signal.SIGKILL)
    with pytest.raises(BusError, match="hilbench0"):
        link.receive(20.0)
    with pytest.raises(BusError, match="hilbench0"):
        link.send([Frame(0x1, b"")])
    link.close()
    assert list(runtime.folder.glob("*.sock"))
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)
    a.send([Frame(0x1, b"")])
    assert collect(b, 1)
    a.close()
    b.close()


def test_interrupts_of_the_terminal_do_not_reach_the_hub(runtime: Any) -> None:
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)
    (hub,) = runtime.hubs()
    assert os.getsid(hub) != os.getsid(0)
    os.kill(hub, signal.SIGINT)
    a.send([Frame(0x1, b"")])
    assert collect(b, 1)
    a.close()
    b.close()


def test_a_terminated_hub_takes_its_socket_away(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    (hub,) = runtime.hubs()
    os.kill(hub, signal.SIGTERM)
    with pytest.raises(BusError):
        link.receive(20.0)
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
    received: list[Frame] = []
    reader = threading.Thread(target=lambda: received.extend(collect(b, total)))
    reader.start()
    for n in range(total):
        a.send([Frame(0x100, n.to_bytes(4, "big"))])
    still_queued = total - hub_client.statistics(fast.channel).frames
    reader.join()
    assert [int.from_bytes(frame.data, "big") for frame in received] == list(range(total))
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


def raw_station(channel: str) -> socket.socket:
    connection = hub_client.join(channel, Wanted()).connection
    connection.setblocking(True)
    return connection


HEADER = protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0)
RUBBISH: list[Callable[[], bytes]] = [
    lambda: b"x",
    lambda: b"\x07" + bytes(23),
    lambda: HEADER + b"short",
    lambda: HEADER + protocol.CAN_RECORD.pack(0x123, 9, 0, b""),
    lambda: HEADER + protocol.CAN_RECORD.pack(0x20000123, 0, 0, b""),
    lambda: HEADER + protocol.CAN_RECORD.pack(0x923, 0, 0, b""),
    lambda: protocol.HEADER.pack(protocol.KIND_FD, 0) + protocol.FD_RECORD.pack(0x123, 9, 0, b""),
    lambda: protocol.HEADER.pack(protocol.KIND_FD, 0) + protocol.FD_RECORD.pack(0x123, 255, 0, b""),
]


def test_rubbish_does_not_upset_the_hub(runtime: Any) -> None:
    a, b = open_link(VIRTUAL), open_link(VIRTUAL)
    rude = raw_station(VIRTUAL.channel)
    for packet in RUBBISH:
        rude.send(packet())
    assert runtime.eventually(lambda: hub_client.statistics(VIRTUAL.channel).malformed == len(RUBBISH))
    a.send([Frame(0x1, b"")])
    assert heard(collect(b, 1)) == [(0x1, b"")]
    rude.close()
    a.close()
    b.close()


REFUSED = [
    b"\xff\xfe",
    b"[" * 5000,
    b"7",
    b"{}",
    b'{"request": "join", "bitrate": "fast"}',
    b'{"request": "join", "bitrate": 0}',
    b'{"request": "join", "timing": "warp"}',
    b'{"request": "join", "filters": [[1]]}',
    b'{"request": "join", "filters": {"a": 1}}',
    b'{"request": "set_filters", "station": 999}',
    b'{"request": "set_filters", "station": true}',
    b'{"request": "set_errors", "lost": 2}',
    b'{"request": "set_errors", "lost": "often"}',
    b'{"request": "set_errors", "seed": 1e999}',
    b'{"request": "set_errors", "unknown": 2}',
    b'{"request": "set_priority", "priority": 0}',
    b'{"request": "set_priority", "priority": 100}',
    b'{"request": "set_priority"}',
]


def test_the_wire_takes_a_priority_or_says_that_it_may_not(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    assert policies(runtime.folder) == [os.SCHED_OTHER]
    said, wanted = "", os.SCHED_FIFO
    try:
        hub_client.set_priority(VIRTUAL.channel, 7)
    except BusError as refused:
        said, wanted = str(refused), os.SCHED_OTHER
    assert policies(runtime.folder) == [wanted]
    assert ("SCHED_FIFO is not permitted" in said) is bool(said)
    link.close()


def policies(folder: Path) -> list[int]:
    """Of the hubs in this runtime directory, how they are scheduled."""
    found = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError, ValueError):
            words = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            if "hilbench.can.hub" in words and str(folder) in words:
                found.append(os.sched_getscheduler(int(entry.name)))
    return found


def test_requests_that_cannot_be_carried_out_are_answered(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    for text in REFUSED:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
            connection.settimeout(20)
            connection.connect(str(runtime.folder / "hilbench0.sock"))
            connection.send(text)
            assert connection.recv(1 << 16).startswith(b'{"error": '), text
    assert hub_client.statistics(VIRTUAL.channel).stations == 1
    link.close()


def test_a_link_refuses_what_no_wire_carries(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    for can_id, data in ((0x800, b""), (0x123, bytes(9)), (0x20000001, b""), (0x800 | REMOTE_FLAG, b"")):
        with pytest.raises(ValueError, match=f"0x{can_id:X}"):
            link.send([Frame(can_id, data)])
    link.close()


def test_a_bus_that_runs_otherwise_is_refused(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    with pytest.raises(BusError, match="bitrate is 1000000 bit/s on the bus that runs, asked for 500000"):
        open_link(BusAddress(timing="virtual", bitrate=500_000))
    with pytest.raises(BusError, match="timing is virtual"):
        open_link(REAL)
    link.close()
    again = open_link(BusAddress(bitrate=500_000))  # nobody is on it any more
    assert hub_client.statistics(REAL.channel).bitrate == 500_000
    again.close()


def test_channels_do_not_hear_each_other(runtime: Any) -> None:
    here, there = open_link(BusAddress("embedded", "here", timing="virtual")), open_link(VIRTUAL)
    here.send([Frame(0x1, b"")])
    assert runtime.eventually(lambda: hub_client.statistics("here").frames == 1)
    assert there.receive(0.0) == []
    assert hub_client.running_channels() == ["here", "hilbench0"]
    here.close()
    there.close()


def test_only_its_user_can_enter(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    assert runtime.folder.stat().st_mode & 0o777 == 0o700
    assert (runtime.folder / "hilbench0.sock").stat().st_mode & 0o077 == 0
    link.close()
    runtime.folder.chmod(0o755)
    with pytest.raises(BusError, match="mode is 0755, expected 0700"):
        open_link(VIRTUAL)
    runtime.folder.chmod(0o700)


def test_a_directory_of_somebody_else_is_refused(runtime: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime.folder.mkdir(mode=0o700)
    uid = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: uid + 1)
    with pytest.raises(BusError, match=f"belongs to user {uid}, expected user {uid + 1}"):
        open_link(VIRTUAL)


def test_a_link_in_the_place_of_the_directory_is_refused(runtime: Any, tmp_path: Path) -> None:
    runtime.folder.symlink_to(tmp_path)
    with pytest.raises(BusError, match="expected a directory"):
        open_link(VIRTUAL)
    runtime.folder.unlink()


def test_the_user_at_the_other_end_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with here, there:
        uid = os.getuid()
        monkeypatch.setattr(protocol, "peer_user", lambda connection: uid)
        assert protocol.may_join(here)
        assert protocol.may_trust(here)
        monkeypatch.setattr(protocol, "peer_user", lambda connection: 4711)
        monkeypatch.setattr(os, "getuid", lambda: 4712)
        assert not protocol.may_join(here)
        assert not protocol.may_trust(here)
        monkeypatch.setattr(os, "getuid", lambda: 0)  # root goes onto everybody's bus,
        assert protocol.may_trust(here)
        assert not protocol.may_join(here)
        monkeypatch.setattr(os, "getuid", lambda: 4712)
        monkeypatch.setattr(protocol, "peer_user", lambda connection: 0)
        assert protocol.may_join(here)  # and is let onto it
        assert not protocol.may_trust(here)


@pytest.mark.parametrize("channel", ["../up", "a/b", "", ".hidden", "x" * 49, "new\nline"])
def test_names_that_cannot_be_channels(runtime: Any, channel: str) -> None:
    with pytest.raises(BusError, match="channel") as caught:
        open_link(BusAddress("embedded", channel))
    assert "\n" not in str(caught.value)


def test_a_bus_of_another_session_is_found_by_its_name(runtime: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    name = f"s{uuid.uuid4().hex[:10]}"
    address = BusAddress("embedded", name, 500_000, "virtual")
    place = address.place
    with closing(open_link(address)) as link, claim(place, {MASTER: "nobody"}, "bench"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime.folder))  # another one
        runtime.folder.chmod(0o700)
        assert not hub_client.runs(name)
        found = BusAddress.parse(f"embedded:{name}").as_it_runs()
        assert (found.bitrate, found.timing, found.place) == (500_000, "virtual", place)
        with closing(open_link(found)) as there:
            there.send([Frame(0x123, b"")])
            assert collect(link, 1)
        assert BusAddress.parse("embedded:none").as_it_runs().channel == "none"
    (runtime.folder / "hilbench").rmdir()


def test_without_a_name_it_is_the_only_bus_that_runs(runtime: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hilbench.can.open.embedded_channels", hub_client.running_channels)
    unnamed = BusAddress.parse("embedded")
    with pytest.raises(UnusableInputError, match="no embedded bus of this user runs; expected embedded:NAME"):
        unnamed.as_it_runs()
    with closing(open_link(VIRTUAL)):
        assert unnamed.as_it_runs().channel == VIRTUAL.channel
        with (
            closing(open_link(BusAddress("embedded", "another"))),
            pytest.raises(UnusableInputError, match=f"these run: another, {VIRTUAL.channel}; expected embedded:NAME"),
        ):
            unnamed.as_it_runs()


def test_asking_a_bus_that_does_not_run(runtime: Any) -> None:
    with pytest.raises(BusError, match="nowhere: no program has it open"):
        hub_client.statistics("nowhere")


def test_the_hub_needs_only_the_standard_library(runtime: Any) -> None:
    """It starts without site-packages: so it starts fast, whatever is installed."""
    link = open_link(VIRTUAL)
    (hub,) = runtime.hubs()
    words = Path(f"/proc/{hub}/cmdline").read_bytes().split(b"\0")
    assert b"-S" in words
    maps = Path(f"/proc/{hub}/maps").read_text()
    assert "site-packages" not in maps
    link.close()


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
