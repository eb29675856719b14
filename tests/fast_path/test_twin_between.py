"""What comes between a SYNC and the axes' answers to it: the twin's fast-path cycles go on in objects there, and say
the same. The hub is the test: it plays to two twins what a third one has heard from a bench."""

from __future__ import annotations

import socket
import struct
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from tests.fast_path.test_packets import run
from tests.fast_path_runs import CONFIGS, How, download, objects_of, sets

from hilbench.can import embedded, hub_client, protocol
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.frame import Frame
from hilbench.can.requests import Settings
from hilbench.canopen import clock
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.identifiers import SYNC
from hilbench.runs.config import load_with_overrides
from hilbench.twin.fast_path_run import TwinFastCycle
from hilbench.twin.process import TwinApplication, twin
from hilbench.twin.run import fast_path_host

Packet = list[Frame]
#: Long enough for what was sent to be there; nobody waits for it to end.
A_MOMENT_S = 0.01
AXES = (0x181, 0x182)


def frames_of(packet: bytes, record: struct.Struct) -> Packet:
    body = packet[protocol.HEADER.size :]
    return [Frame(fields[0], fields[3][: fields[1]], 0) for fields in record.iter_unpack(body)]


def heard_by_a_twin(folder: Path, name: str = "web_section_step", path: str = "line_speed_m_s") -> list[Packet]:
    """All that the twin of a bench receives in 220 cycles, at something that is set."""
    received = dict[str, list[Packet]]()
    receive = embedded.receive_packet

    def kept(*arguments: Any, **flags: int) -> bytes | None:
        packet = receive(*arguments, **flags)
        if packet is not None:
            by = threading.current_thread().name
            received.setdefault(by, []).append(frames_of(packet, protocol.STAMPED_CAN_RECORD))
        return packet

    changes = [f"bus.address=embedded:b{uuid.uuid4().hex[:10]}"]
    loaded = load_with_overrides(CONFIGS / f"{name}.yaml", changes=changes)
    with patch.object(embedded, "receive_packet", kept):
        run(folder, loaded, [(10, sets(path, 0.4))], 220, How.INTERPRETED)
    ids = {name: {frame.can_id for packet in each for frame in packet} for name, each in received.items()}
    return next(each for name, each in received.items() if {SYNC, AXES[0]} <= ids[name])


@contextmanager
def linked() -> Iterator[tuple[EmbeddedLink, socket.socket]]:
    """A link whose hub is the other end."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    membership = hub_client.Membership(theirs, 1, Settings(1_000_000, 2_000_000, "virtual"))
    with patch.object(hub_client, "join", lambda *_, **__: membership), patch.object(hub_client, "set_filters"):
        link = EmbeddedLink("here", 1_000_000, "virtual")
        yield link, ours
        link.close()
        ours.close()


@contextmanager
def standing_clock() -> Iterator[None]:
    """Before the first SYNC heartbeats go by the wall clock, and behind it from where that has left them."""
    now_ns = time.monotonic_ns()
    with patch.object(clock, "time", SimpleNamespace(monotonic_ns=lambda: now_ns)):
        yield


class Played:
    """What a twin has answered to packets, and how its fast-path cycles ended: SYNCs answered, axes waited for."""

    def __init__(self, packets: Sequence[Packet], *, compiled: bool) -> None:
        self.said: list[Packet] = []
        self.ends: list[tuple[int, bool]] = []
        config = load_with_overrides(CONFIGS / "web_section_step.yaml").config
        end = TwinFastCycle.end

        def kept(of: TwinFastCycle) -> None:
            self.ends.append((of._answers.cycles, of._awaits))
            end(of)

        with linked() as (link, hub), patch.object(TwinFastCycle, "end", kept), ExitStack() as until_sync:
            until_sync.enter_context(standing_clock())
            hosted = twin(config)
            host = DeviceHost(link, *hosted)
            fast = fast_path_host(host, link, hosted)
            serve = fast.serve if compiled and fast is not None else host.serve
            host.boot()
            for packet in packets:
                if any(frame.can_id == SYNC for frame in packet):
                    until_sync.close()
                records = b"".join(
                    protocol.STAMPED_CAN_RECORD.pack(frame.can_id, len(frame.data), 0, frame.data, 0)
                    for frame in packet
                )
                hub.send(protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0) + records)
                serve(A_MOMENT_S)
                self.said += self._answers(hub)
            if fast is not None:
                fast.settle()
        self.objects = objects_of([hosted])
        application = hosted.application
        assert isinstance(application, TwinApplication)
        self.counted = application.missed, application.surplus, application.malformed

    @staticmethod
    def _answers(hub: socket.socket) -> Iterator[Packet]:
        while True:
            try:
                yield frames_of(hub.recv(protocol.PACKET_BYTES, socket.MSG_DONTWAIT), protocol.CAN_RECORD)
            except BlockingIOError:
                return


def only(*cob_ids: int) -> Callable[[Packet], list[Packet]]:
    """Of the axes' answers these, each in a packet of its own, in this order."""
    return lambda packet: [[frame] for cob_id in cob_ids for frame in packet if frame.can_id == cob_id]


def before(*frames: Frame) -> Callable[[Packet], list[Packet]]:
    return lambda packet: [list(frames), packet]


def behind(*frames: Frame) -> Callable[[Packet], list[Packet]]:
    return lambda packet: [packet, list(frames)]


UPLOAD = Frame(0x620, bytes((0x40, 0x00, 0x21, 3, 0, 0, 0, 0)))  # of the twin's status
#: What happens to the packet with the axes' answers, every tenth cycle.
INSTEAD: list[Callable[[Packet], list[Packet]]] = [
    only(*AXES),
    only(*reversed(AXES)),
    lambda packet: [packet[::-1]],
    lambda packet: [],
    only(AXES[0]),
    only(AXES[0], AXES[0], AXES[1]),
    before(UPLOAD),
    behind(UPLOAD),
    before(download(32, 0x2101, 2, 1, 1)),  # another method
    lambda packet: [[packet[0], UPLOAD, *packet[1:]]],
    lambda packet: [[packet[0]._replace(data=packet[0].data[:-1]), *packet[1:]], packet],
    behind(Frame(AXES[0], bytes(8))),
    before(Frame(0x001, b"")),  # emergency stop
]


@pytest.mark.slow
def test_what_comes_between_sync_and_its_answers_is_taken_alike(tmp_path: Path) -> None:
    packets, changed = list[Packet](), 0
    cycles = 0
    for packet in heard_by_a_twin(tmp_path):
        cycles += sum(frame.can_id == SYNC for frame in packet)
        of_axes = {frame.can_id for frame in packet} == set(AXES)
        if of_axes and cycles >= 80 + 10 * changed and changed < len(INSTEAD):
            packets += INSTEAD[changed](packet)
            changed += 1
        elif of_axes and 30 <= cycles < 75:
            # Also where the fast path has only just begun: it begins with any packet, at intervals.
            packets += [packet, *[[UPLOAD]] * (cycles % 3)]
        else:
            packets.append(packet)
    assert changed == len(INSTEAD)
    one, other = (Played(packets, compiled=compiled) for compiled in (True, False))
    assert one.counted == other.counted
    assert min(one.counted) > 0
    assert one.said == other.said
    assert one.objects == other.objects
    assert sum(answered for answered, _ in one.ends) > 60, one.ends
    assert (0, False) in one.ends, one.ends
    assert [awaited for _, awaited in one.ends].count(True) >= 6, one.ends
