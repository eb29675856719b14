"""Rows of the matrix in which a stranger on the bus sends what is the bench's, the nodes', or a master's to send."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

from faults.acts import bus_of
from faults.run import Fault, Run
from hilbench.can.frame import Frame
from hilbench.can.open import open_link
from hilbench.canopen.identifiers import SDO_REQUEST
from hilbench.errors import BusError

#: What a stranger sends, in how many batches, and how long it waits after each.
_TIMES, _PAUSE_S = 300, 0.005
#: EMCY frames of a flood, and how many of them at once.
_FLOOD, _AT_ONCE = 320_000, 64
_STOP, _START = 2, 1
_STOPS = {"cycle_timeout_s": 1.0, "on_foreign_frames": "stop"}


def send_again_and_again(*frames: Frame, times: int = _TIMES, pause_s: float = _PAUSE_S) -> Callable[[Run], None]:
    """A stranger that sends these frames until it has done so often enough, or the run has ended."""

    def act(run: Run) -> None:
        run.wait_for_speed()
        link = open_link(bus_of(run))
        link.set_filters([(0x7FF, 0x7FF)])
        try:
            for _ in range(times):
                if run.process.poll() is not None:
                    return
                link.send(frames)
                time.sleep(pause_s)
        except BusError:
            if run.process.poll() is None:  # the bus ends with the run
                raise
        finally:
            link.close()

    return act


def download(node_id: int, index: int, value: int, size: int, sub: int = 0) -> Frame:
    """An SDO write, as another master would send it."""
    head = bytes((0x23 | (4 - size) << 2,)) + index.to_bytes(2, "little") + bytes((sub,))
    return Frame(SDO_REQUEST + node_id, head + value.to_bytes(4, "little"))


def attacks(long: list[dict[str, Any]], loop_back: list[dict[str, Any]]) -> Iterator[Fault]:
    """The rows; `long` are steps of a run that goes on for a while, `loop_back` those that wait for the loop."""
    second, twice = "told, what comes first is used", "more often than SYNC asks for it"
    state = struct.pack("<ff", 80.0, 17.4e9)
    told = {"steps": long}
    yield _told("a second sender of a drive's TPDO", second, f"282h) {twice}", Frame(0x282, bytes(4)), told)
    yield _told("a second sender of node 32, E doubled", second, f"1A0h) {twice}", Frame(0x1A0, state), told)
    counter = Frame(0x3A0, struct.pack("<HBB", 0x7FFF, 0, 3))
    yield _told("a wrong SYNC counter of node 32", "told", "3A0h)", counter, told)
    yield _told("a TPDO of a wrong length", "told, not used", "of a length other than", Frame(0x181, bytes(5)), told)
    yield _told("the bench's heartbeat of somebody else", "told", "heartbeat (COB-ID 77Fh)", Frame(0x77F, b"\5"), told)
    for index, value, size, sub, codes in (
        (0x6060, 8, 1, 0, (0, 3)),
        (0x6085, 1, 4, 0, (0,)),
        (0x1016, 0, 4, 1, (0,)),
    ):
        yield Fault(
            f"attack: {index:04X}h of a drive written by SDO",
            "told with node, object and value",
            codes,
            f"SDO write by another station: {index:04X}h sub {sub}",
            send_again_and_again(download(1, index, value, size, sub), times=1),
            told,
        )
    yield Fault(
        "attack: SDO reads of a drive",
        "nothing to tell",
        (0,),
        "",
        send_again_and_again(Frame(0x601, bytes.fromhex("4041600000000000"))),
        told,
    )
    for name, frame, words in (
        ("SYNC", Frame(0x080, b""), "SYNC (COB-ID 080h) that the bench has not sent"),
        ("RPDO", Frame(0x203, bytes.fromhex("0f000000")), "RPDO (COB-ID 203h) that the bench has not sent"),
    ):
        yield Fault(
            f"attack: {name} of somebody else",
            "told; goes on, or stops safely",
            (0, 3),
            words,
            send_again_and_again(frame),
            told,
        )
    yield Fault(
        "attack: NMT stop of a drive",
        "quick stop, exit 3, the command named",
        (3,),
        "NMT 'stop'",
        send_again_and_again(_nmt(_STOP, 1), times=1),
    )
    stop_twin = [_nmt(_STOP, node_id) for node_id in (17, 18, 32)]
    yield Fault(
        "attack: NMT stop of the twin",
        "loop opens, twin taken back, loop closes",
        (0,),
        "tension loop closed again",
        send_again_and_again(*stop_twin, times=1),
        {"steps": loop_back},
    )
    yield Fault(
        "attack: NMT stop and start of node 32",
        "loop opens, twin taken back, loop closes",
        (0,),
        "tension loop closed again",
        send_again_and_again(_nmt(_STOP, 32), _nmt(_START, 32), times=1),
        {"steps": loop_back},
    )
    yield Fault(
        "attack: NMT stop of the twin, again and again",
        "loop opens, cycles go on",
        (0,),
        "tension loop open",
        send_again_and_again(*stop_twin),
        told,
    )
    yield Fault(
        f"attack: {_FLOOD} forged EMCY frames",
        "one warning with their number",
        (0,),
        "EMCY 2310h: current (",
        send_again_and_again(*[Frame(0x081, bytes.fromhex("1023030000000000"))] * _AT_ONCE, times=_FLOOD // _AT_ONCE),
        told,
    )
    for name, frame in (
        ("a second sender of a TPDO", Frame(0x282, bytes(4))),
        ("an SDO write", download(1, 0x1016, 0, 4, 1)),
    ):
        yield Fault(
            f"attack: {name}, on_foreign_frames: stop",
            "quick stop, exit 3",
            (3,),
            "foreign frames, axis",
            send_again_and_again(frame),
            {"steps": long, "safety": _STOPS},
        )


def _told(name: str, expected: str, words: str, frame: Frame, changes: dict[str, Any]) -> Fault:
    return Fault(f"attack: {name}", expected, (0,), words, send_again_and_again(frame), changes)


def _nmt(command: int, node_id: int) -> Frame:
    return Frame(0x000, bytes((command, node_id)))
