"""What is fuzzed: readers of files, and what takes frames or requests. It takes any bytes; what it raises is a defect.

`tools/fuzz.py` searches for bytes that make one fail, guided by coverage; what it has found is kept in `found/`.
"""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from hilbench.apps.monitor.picture import BusPicture
from hilbench.can import protocol
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.hub import Client, Hub
from hilbench.can.requests import RefusedError, Settings, parse
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.cia402.configuration import default_reader
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.units import DriveUnits
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.plant.motor_port import MotorPort
from hilbench.results.import_mapping import read_foreign
from hilbench.results.journal import read_journal
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.trace_files import read_trace
from hilbench.runs.config import load

ROOT = Path(__file__).resolve().parents[2]
CONFIG = ROOT / "bench_configs" / "web_section_step.yaml"
SERVO = ROOT / "eds" / "hilbench_servo.eds"
_MAPPING = b"file: {delimiter: ';', decimal: ','}\nchannels:\n  t_s: time\n  x1_m: {column: pos, factor: 0.001}\n"
_DIALOGUE = (  # NMT start, SDO read, SDO write, segmented read, SYNC, RPDO1
    Frame(0x000, b"\x01\x05"),
    Frame(0x605, bytes.fromhex("4018100100000000")),
    Frame(0x605, bytes.fromhex("2b17100064000000")),
    Frame(0x605, bytes.fromhex("4008100000000000")),
    Frame(0x605, bytes.fromhex("6000000000000000")),
    Frame(0x080, b""),
    Frame(0x205, bytes(6)),
)


@dataclass(frozen=True)
class Target:
    """One thing to fuzz: `run` takes any bytes, `seeds` are good inputs to begin with."""

    run: Callable[[bytes], None]
    seeds: Callable[[], list[bytes]]


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="fuzz-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None))


def _file(name: str, read: Callable[[Path], object]) -> Callable[[bytes], None]:
    """Reading a file of any content gives something, or one printable line that names the file."""

    def run(data: bytes) -> None:
        path = _folder() / name
        path.write_bytes(data)
        try:
            read(path)
        except UnusableInputError as error:
            said = str(error)
            if not (said.startswith(str(_folder())) and said.isprintable()):
                raise AssertionError(f"not one line that names the file: {said!r}") from error

    return run


# -- frames ------------------------------------------------------------------------------------------------------------


def frames_of(data: bytes) -> Iterator[Frame]:
    """Frames in any bytes: identifier (2 bytes), flags and length (1), data."""
    at = 0
    while at + 3 <= len(data):
        word, how = int.from_bytes(data[at : at + 2], "little"), data[at + 2]
        length = how & 0x0F if how & 0x0F <= 8 else 8
        flags = (REMOTE_FLAG if how & 0x40 else 0) | (EXTENDED_FLAG if how & 0x80 else 0)
        yield Frame(word & 0x7FF | flags, data[at + 3 : at + 3 + length])
        at += 3 + length


def bytes_of(frames: list[Frame]) -> bytes:
    """The bytes from which `frames_of` makes these."""
    return b"".join(
        (frame.can_id & 0x7FF).to_bytes(2, "little") + bytes((len(frame.data),)) + frame.data for frame in frames
    )


@cache
def _drive() -> tuple[Device, SimulatedDrive]:
    device = Device(load_eds(SERVO, 5), 5, MonotonicClock())
    return device, SimulatedDrive(device, MotorPort())


def _to_device(data: bytes) -> None:
    device, drive = _drive()
    device.handle(Frame(0x000, b"\x81\x05"))  # reset node: nothing is left of the input before
    device.boot()
    for frame in frames_of(data):
        if frame.can_id == device.sync_cob_id:
            device.sync(frame.data)
            drive.sync(0.002)
        else:
            device.handle(frame)
        device.poll()
        said = len(device.replies) + len(device.outbox)
        assert said <= 300, f"{said} frames for one"  # a block of 127 segments is an answer, too
        device.replies, device.outbox = [], []


@cache
def _bench() -> Nodes:
    nodes = Nodes(load(CONFIG)[0])
    for drive in nodes.drives:
        drive.units = DriveUnits.from_objects(default_reader(drive.od), {}, drive.settings.name)
    return nodes


def _to_bench(data: bytes) -> None:
    """One bench takes it all: making a new one would take longer than the frames."""
    nodes = _bench()
    for frame in frames_of(data):
        said = ""
        try:
            nodes.decode([frame])
        except BenchFaultError as error:
            said = str(error)
        assert said.isprintable()
    nodes.encode({"strain_prev": 0.0, "F_next_N": 0.0})


@cache
def _picture() -> BusPicture:
    return BusPicture(load(CONFIG)[0])


def _to_monitor(data: bytes) -> None:
    _picture().take([frame._replace(time_ns=2_000_000 * n) for n, frame in enumerate(frames_of(data))])


def _to_hub(data: bytes) -> None:
    """A request, or the packets of a station; each begins with its length (1 byte)."""
    said = ""
    try:
        parse(data)
    except RefusedError as error:
        said = str(error)
    assert len(said) < protocol.PACKET_BYTES / 2
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    hub = Hub("fuzz", listener)
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        client = Client(here, 1)
        client.fd = bool(data[:1] > b"\x7f")
        hub.settings = Settings(timing="virtual" if data[:1] < b"\x40" else "real")
        at = 1
        while at + 1 < len(data):
            size = data[at] + 1
            hub._take_frames(client, data[at + 1 : at + 1 + size])
            at += 1 + size
        assert hub.malformed >= 0
    finally:
        hub._epoll.close()
        for each in (listener, here, there):
            each.close()


# -- all of them -------------------------------------------------------------------------------------------------------


def _text(path: Path, most: int | None = None) -> Callable[[], list[bytes]]:
    return lambda: [path.read_bytes()[:most]]


def _recordings(name: str) -> Callable[[], list[bytes]]:
    def seeds() -> list[bytes]:
        import numpy as np

        from hilbench.results.recording import Recording, write_recording

        t = np.arange(5) * 0.002
        path = _folder() / f"seed-{name}"
        write_recording(Recording({"t_s": t, "v1_m_s": np.sin(t)}), path)
        return [path.read_bytes()]

    return seeds


def _results() -> list[bytes]:
    from hilbench.results.result import Fault, Timing

    timing = Timing(
        pace="lockstep", cycle_us=2000, cycles=9, missed=0, jitter_us=None, realtime_factor=1.0, bus_load_pct=60.0
    )
    path = _folder() / "seed.json"
    Result.of([], {"a": 1.0}, timing, [Fault(time_s=1.0, source="bench", text="broken")]).write(path)
    return [path.read_bytes()]


def _packets() -> list[bytes]:
    record = protocol.HEADER.pack(protocol.KIND_CLASSICAL, 0) + protocol.CAN_RECORD.pack(0x123, 8, 0, bytes(8))
    joins = b'{"request": "join", "bitrate": 1000000, "timing": "virtual", "filters": [[1, 2]]}'
    errors = b'{"request": "set_errors", "seed": 1, "lost": 0.1, "delay_s": 0.1}'
    return [b"\x00" + bytes((len(record) - 1,)) + record, joins, errors]


def _mapped(path: Path) -> object:
    table = _folder() / "table.csv"
    table.write_bytes(b"time;pos\n0,0;1\n0,1;2\n0,2;3\n")
    return read_foreign(table, path)


_CANDUMP = b"(1.000001) vcan0 181#0011AABB\n(1.000002) vcan0 080#\n(1.000003) vcan0 00000581#R\n"

_ASC = b"date Thu Jan 1\nbase hex  timestamps absolute\n 0.1 1  181             Rx   d 2 00 11\n"
_TRC = b";$FILEVERSION=1.1\n;$STARTTIME=43008.9\n 1)     17535.4  Rx         00000300  8  00 00 00 00 04 00 00 00\n"
_HEARD = [Frame(0x080, b""), Frame(0x181, bytes(8)), Frame(0x701, b"\x05"), Frame(0x081, bytes(8))]


def _trace(path: Path) -> object:
    return list(read_trace(path))


TARGETS = {
    "config": Target(_file("bench.yaml", load), _text(CONFIG)),
    "eds": Target(_file("drive.eds", lambda path: load_eds(path, 1)), _text(SERVO, 3000)),
    "result": Target(_file("result.json", Result.read), _results),
    "journal": Target(_file("journal.log", read_journal), lambda: [b'[3, "enabled"]\n[5, "set", "x", 0.5]\n']),
    "csv": Target(_file("recording.csv", read_recording), _recordings("r.csv")),
    "mdf": Target(_file("recording.mf4", read_recording), _recordings("r.mf4")),
    "mapping": Target(_file("mapping.yaml", _mapped), lambda: [_MAPPING]),
    "trace": Target(_file("trace.log", _trace), lambda: [_CANDUMP]),
    "asc": Target(_file("trace.asc", _trace), lambda: [_ASC]),
    "trc": Target(_file("trace.trc", _trace), lambda: [_TRC]),
    "device": Target(_to_device, lambda: [bytes_of(list(_DIALOGUE))]),
    "bench": Target(_to_bench, lambda: [bytes_of(_HEARD)]),
    "monitor": Target(_to_monitor, lambda: [bytes_of(_HEARD)]),
    "hub": Target(_to_hub, _packets),
}
