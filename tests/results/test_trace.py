"""The trace: what is written is what other programs of the field read, and what a crash leaves is readable."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import can
from hilbench.can.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.errors import UnusableInputError
from hilbench.results.trace import TraceReader, TraceWriter
from hilbench.results.trace_files import read_messages

T0 = 1_700_000_000_000_123_000


def write(path: Path, frames: list[Frame], channel: str = "vcan0") -> None:
    with TraceWriter(path, channel) as writer:
        writer.write(frames)


def test_lines_are_candumps(tmp_path: Path) -> None:
    frames = [
        Frame(0x181, b"\x00\x11\xaa\xbb", T0),
        Frame(0x80, b"", T0 + 999),
        Frame(0x18DAF110 | EXTENDED_FLAG, b"\x01\x02", T0 + 1000),
        Frame(0x5 | EXTENDED_FLAG, b"", T0 + 1000),
        Frame(0x181 | REMOTE_FLAG, bytes(8), T0 + 876_999_877_000),
        Frame(0x80 | ERROR_FLAG, bytes(8), 1_000_000_001),
    ]
    write(tmp_path / "trace.log", frames)
    assert (tmp_path / "trace.log").read_text().splitlines() == [
        "(1700000000.000123) vcan0 181#0011AABB",
        "(1700000000.000123) vcan0 080#",
        "(1700000000.000124) vcan0 18DAF110#0102",
        "(1700000000.000124) vcan0 00000005#",
        "(1700000877.000000) vcan0 181#R8",
        "(1.000000) vcan0 20000080#0000000000000000",
    ]


def test_python_can_reads_the_same_frames(tmp_path: Path) -> None:
    frames = [
        Frame(0x7FF, b"\x01\x02\x03", T0),
        Frame(0x181 | REMOTE_FLAG, bytes(8), T0 + 1000),
        Frame(0x1FFFFFFF | EXTENDED_FLAG, bytes(range(8)), T0 + 2000),
        Frame(0x12 | EXTENDED_FLAG | REMOTE_FLAG, b"", T0 + 3000),
        Frame(0x80 | ERROR_FLAG, bytes(8), T0 + 4000),
    ]
    write(tmp_path / "trace.log", frames)
    messages = list(can.CanutilsLogReader(tmp_path / "trace.log"))
    assert messages[-1].is_error_frame
    for frame, message in zip(frames[:-1], messages[:-1], strict=True):
        assert message.arbitration_id == frame.can_id & 0x1FFFFFFF
        assert message.is_extended_id == bool(frame.can_id & EXTENDED_FLAG)
        assert message.is_remote_frame == bool(frame.can_id & REMOTE_FLAG)
        assert message.dlc == len(frame.data)
        assert message.is_remote_frame or bytes(message.data) == frame.data
        assert message.timestamp == pytest.approx(frame.time_ns / 1e9, abs=1e-6)
        assert message.channel == "vcan0"


def test_reads_what_python_can_writes(tmp_path: Path) -> None:
    with can.CanutilsLogWriter(tmp_path / "trace.log", channel="can0") as log:
        log(can.Message(arbitration_id=0x201, is_extended_id=False, data=b"\x0f\x00", timestamp=12.5))
        log(can.Message(arbitration_id=0x201, is_extended_id=True, is_remote_frame=True, dlc=3, timestamp=13.0))
    reader = TraceReader(tmp_path / "trace.log")
    assert list(reader) == [
        Frame(0x201, b"\x0f\x00", 12_500_000_000),
        Frame(0x201 | EXTENDED_FLAG | REMOTE_FLAG, b"", 13_000_000_000),  # its writer leaves the length out
    ]
    assert reader.channels == {"can0"}
    assert not reader.torn


frames_of_any_kind = st.builds(
    lambda identifier, extended, remote, data, microseconds: Frame(
        (identifier | EXTENDED_FLAG if extended else identifier & 0x7FF) | (REMOTE_FLAG if remote else 0),
        bytes(len(data)) if remote else data,
        microseconds * 1000,
    ),
    st.integers(0, 0x1FFFFFFF),
    st.booleans(),
    st.booleans(),
    st.binary(max_size=8),
    st.integers(1, 2**51),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(frames_of_any_kind, max_size=30), st.integers(0, 40))
def test_round_trip_and_torn_end(tmp_path_factory: pytest.TempPathFactory, frames: list[Frame], cut: int) -> None:
    path = tmp_path_factory.mktemp("trace") / "trace.log"
    write(path, frames)
    reader = TraceReader(path)
    assert list(reader) == frames
    assert not reader.torn

    whole = path.read_bytes()
    kept = whole[: max(0, len(whole) - cut)]
    path.write_bytes(kept)
    assert list(reader) == frames[: kept.count(b"\n")]
    assert reader.torn == (bool(kept) and not kept.endswith(b"\n"))


def test_clock_that_jumps_back_stays_visible(tmp_path: Path) -> None:
    frames = [Frame(0x80, b"", T0), Frame(0x80, b"", T0 - 5_000_000_000)]
    write(tmp_path / "trace.log", frames)
    assert [frame.time_ns for frame in TraceReader(tmp_path / "trace.log")] == [T0, T0 - 5_000_000_000]


def test_sent_frames_get_the_time_of_sending(tmp_path: Path) -> None:
    with TraceWriter(tmp_path / "trace.log", "vcan0") as writer:
        writer.write([Frame(0x80, b""), Frame(0x181, b"\x01", T0)], sent_ns=T0 - 1000)
    assert [frame.time_ns for frame in TraceReader(tmp_path / "trace.log")] == [T0 - 1000, T0]


def test_every_ended_cycle_survives_a_kill(tmp_path: Path) -> None:
    script = (
        "import sys, time; from pathlib import Path; from hilbench.can.frame import Frame\n"
        "from hilbench.results.trace import TraceWriter\n"
        "writer = TraceWriter(Path(sys.argv[1]), 'vcan0')\n"
        "for cycle in range(5):\n"
        "    writer.write([Frame(0x80, b'', cycle + 1), Frame(0x181, bytes([cycle]), cycle + 1)])\n"
        "    writer.end_cycle()\n"
        "writer.write([Frame(0x7FF, b'not handed over', 1)])\n"
        "print('ready', flush=True); time.sleep(60)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path / "trace.log")], stdout=subprocess.PIPE, env=environment
    )
    assert process.stdout is not None
    assert process.stdout.readline().strip() == b"ready"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    data = [frame.data for frame in TraceReader(tmp_path / "trace.log") if frame.can_id == 0x181]
    assert data == [bytes([cycle]) for cycle in range(5)]


def test_an_existing_trace_is_kept(tmp_path: Path) -> None:
    write(tmp_path / "trace.log", [Frame(0x80, b"", T0)])
    with pytest.raises(UnusableInputError, match=r"trace\.log: cannot be created"):
        TraceWriter(tmp_path / "trace.log", "vcan0")
    assert len(list(TraceReader(tmp_path / "trace.log"))) == 1


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("(1.0) vcan0 181#0", "181#0"),
        ("(1.0) vcan0 181##1AABB", "181##1AABB"),
        ("(1.0) vcan0 999#", "999h"),
        ("hello", "hello"),
        ("(1.0) vcan0 181#" + "00" * 9, "181#"),
        ("x" * 600, "xxx"),
    ],
)
def test_anything_else_is_named_with_its_line(tmp_path: Path, line: str, found: str) -> None:
    path = tmp_path / "trace.log"
    path.write_text(f"(1.0) vcan0 080#\n{line}\n(1.0) vcan0 080#\n")
    with pytest.raises(UnusableInputError) as caught:
        list(TraceReader(path))
    text = str(caught.value)
    assert text.startswith(f"{path}:2: ")
    assert found in text or "without end" in text
    assert "\n" not in text


def test_channel_is_one_word(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="one word"):
        TraceWriter(tmp_path / "trace.log", "my bus")


def test_missing_trace(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="cannot be read"):
        list(TraceReader(tmp_path / "trace.log"))


def test_disk_full(tmp_path: Path) -> None:
    """The process' own file size limit stands in for a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    said: list[str] = []
    writer = TraceWriter(tmp_path / "trace.log", "vcan0", warn=said.append)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
        for _ in range(2):
            writer.write([Frame(0x181, bytes(8), T0)] * 10)
            writer.end_cycle()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
        writer.close()
    reader = TraceReader(tmp_path / "trace.log")
    assert len(list(reader)) == 2
    assert reader.torn
    assert len(said) == 1
    assert "the trace cannot be written" in said[0]


def write_long(path: Path, cycles: int, **settings: Any) -> list[Frame]:
    """A trace of so many cycles; its frames."""
    frames = [Frame(0x181, k.to_bytes(8, "little"), T0 + 1000 * k) for k in range(cycles)]
    with TraceWriter(path, "vcan0", **settings) as writer:
        for frame in frames:
            writer.write([frame])
            writer.end_cycle()
    return frames


@pytest.mark.parametrize("compress", [False, True])
def test_a_long_trace_goes_on_in_further_files_and_is_read_as_one(tmp_path: Path, compress: bool) -> None:
    path = tmp_path / "trace.log"
    frames = write_long(path, 2000, part=20_000, compress=compress)
    names = sorted(each.name for each in tmp_path.iterdir())
    assert len(names) == 5
    assert names[:2] == ["trace.1.log.gz", "trace.2.log.gz"] if compress else ["trace.1.log", "trace.2.log"]
    assert path.stat().st_size < 21_000
    assert list(TraceReader(path)) == frames
    assert len(list(read_messages(path))) == 2000


def test_a_trace_ends_at_what_is_to_be_kept_and_says_so_before(tmp_path: Path) -> None:
    said: list[str] = []
    frames = write_long(tmp_path / "trace.log", 2000, keep=45_000, warn=said.append)
    assert ["then the trace ends" in said[0], "keep_MB" in said[1], len(said)] == [True, True, 2]
    found = list(TraceReader(tmp_path / "trace.log"))
    assert 900 < len(found) < 1200
    assert found == frames[: len(found)]
