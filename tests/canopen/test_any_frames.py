"""Whatever comes over the bus, in whatever order: the device goes on, and answers when it is asked."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from tests.canopen.device_under_test import DriveUnderTest

Step = Callable[[DriveUnderTest], object]

INVALID = 0x80000000
REMOTE = 0x40000000
DEVICE_TYPE = "4300100092010200"
ABORT = bytes((0x80, *bytes(7)))  #: ends the transfer that may be under way
#: COB-ID and what may be mapped: RPDO1, TPDO1.
PDOS = {
    (0x1400, 0x205): [0x60400010, 0x60FF0020, 0x60710010, 0x00050008],
    (0x1800, 0x185): [0x60410010, 0x60640020, 0x60770010],
}


def download(index: int, sub: int, value: int, size: int) -> bytes:
    """The request of an expedited download."""
    return bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, sub)) + value.to_bytes(4, "little")


def remap(pdo: tuple[int, int], places: list[int], kind: int, event_ms: int) -> Step:
    """The mapping procedure; entries by their places among the candidates."""
    (communication, cob_id), candidates = pdo, PDOS[pdo]
    mapping = communication + 0x200
    entries = [candidates[place % len(candidates)] for place in places]
    requests = [
        ABORT,
        download(communication, 1, INVALID | cob_id, 4),
        download(mapping, 0, 0, 1),
        *(download(mapping, sub, entry, 4) for sub, entry in enumerate(entries, 1)),
        download(mapping, 0, len(entries), 1),
        download(communication, 2, kind, 1),
        download(communication, 5, event_ms, 2),
        download(communication, 1, cob_id, 4),
    ]

    def step(drive: DriveUnderTest) -> None:
        for request in requests:
            drive.send(0x605, request)

    return step


def frame(can_id: int, data: bytes) -> Step:
    return lambda drive: drive.send(can_id, data)


def sync(data: bytes) -> Step:
    return lambda drive: drive.sync(data)


def time_passes(duration_ms: int) -> Step:
    return lambda drive: drive.after(duration_ms)


#: A frame of 8 bytes is long enough for any mapping.
DATA = st.binary(min_size=8, max_size=8) | st.binary(max_size=8)
OBJECTS = st.sampled_from(["0510", "1410", "1510", "1710", "1910", "4060", "6060", "5a60", "0120", "ff60", "0810"])
REQUESTS = st.builds(
    lambda head, index, sub, data: bytes((head,)) + bytes.fromhex(index) + bytes((sub,)) + data,
    st.integers(0, 255),
    OBJECTS,
    st.integers(0, 3),
    st.binary(min_size=4, max_size=4),
)
COMMANDS = [*[b"\x01\x05"] * 4, b"\x02\x00", b"\x80\x05", b"\x81\x05", b"\x82\x05"]  # mostly: start
STEPS = st.one_of(
    st.builds(
        remap,
        st.sampled_from(sorted(PDOS)),
        st.lists(st.integers(0, 3), max_size=3),
        st.sampled_from([0, 1, 2, 240, 254, 255]),
        st.sampled_from([0, 10]),
    ),
    st.builds(frame, st.just(0x205), DATA),
    st.builds(frame, st.just(0x605), REQUESTS),
    st.builds(frame, st.sampled_from([0x77F, REMOTE | 0x185, REMOTE | 0x285, REMOTE | 0x705]), st.just(b"\0")),
    st.builds(
        frame, st.just(0x000), st.sampled_from([b"\x01\x05", b"\x02\x00", b"\x80\x05", b"\x81\x05", b"\x82\x05"])
    ),
    st.builds(sync, st.binary(max_size=1)),
    st.builds(time_passes, st.sampled_from([0, 1, 20, 300])),
)


@settings(max_examples=100, deadline=None, phases=(Phase.generate, Phase.shrink))
@given(st.lists(STEPS, min_size=40, max_size=80))
def test_device_goes_on(steps: list[Step]) -> None:
    drive = DriveUnderTest().started()
    for step in steps:
        step(drive)
    drive.nmt(1)
    drive.frames()
    drive.send(0x605, ABORT)
    assert drive.sdo("40 00 10 00 00000000") == DEVICE_TYPE
