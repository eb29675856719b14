"""A device in a test: an EDS written here, a clock set by hand, requests and answers as bytes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

from tests.buses import Bus

from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.plant.motor_port import MotorPort

NODE = 5
SERVO_EDS = Path(__file__).parents[2] / "eds" / "hilbench_servo.eds"
U8, U16, U32, I8, I16, I32, I24, REAL32, STRING, DOMAIN, BOOLEAN = 5, 6, 7, 2, 3, 4, 0x10, 8, 9, 0xF, 1


class Idle:
    """Nothing behind a device."""

    listens_to: frozenset[int] = frozenset()

    def before_sync(self) -> None: ...

    def after_sync(self) -> None: ...

    def on_frame(self, frame: Frame) -> None: ...

    def tick(self, duration_s: float) -> None: ...


def var(name: str, code: int, access: str = "rw", default: str = "0", mappable: bool = False, extra: str = "") -> str:
    """The options of one variable."""
    value = f"DefaultValue={default}\n" if default else ""
    return (
        f"ParameterName={name}\nObjectType=0x7\nDataType=0x{code:04X}\nAccessType={access}\n{value}"
        f"PDOMapping={int(mappable)}\n{extra}"
    )


def record(index: int, name: str, *members: str) -> dict[str, str]:
    """A record with its members from sub-index 1 on."""
    count = var("Highest sub-index supported", U8, "rw" if 0x1600 <= index < 0x1C00 else "ro", str(len(members)))
    sections = {f"{index:04X}": f"ParameterName={name}\nObjectType=0x9\n", f"{index:04X}sub0": count}
    return sections | {f"{index:04X}sub{sub:X}": text for sub, text in enumerate(members, 1)}


def communication(index: int, cob_id: str, kind: int) -> dict[str, str]:
    """PDO communication parameters."""
    return record(
        index,
        f"PDO communication {index:04X}",
        var("COB-ID", U32, default=cob_id),
        var("Transmission type", U8, default=str(kind)),
        var("Inhibit time", U16),
        var("Compatibility entry", U8),
        var("Event timer", U16),
        *([var("SYNC start value", U8)] if index >= 0x1800 else []),
    )


def mapping(index: int, *entries: str) -> dict[str, str]:
    """PDO mapping parameters: these entries of eight."""
    members = [var(f"Entry {n}", U32, default=entry) for n, entry in enumerate((*entries, *["0"] * 8)[:8], 1)]
    sections = record(index, f"PDO mapping {index:04X}", *members)
    return sections | {f"{index:04X}sub0": var("Number of entries", U8, default=str(len(entries)))}


SECTIONS: dict[str, str] = {
    "DeviceInfo": "VendorName=hilbench\nVendorNumber=0x1\n",
    "DummyUsage": "".join(f"Dummy{code:04d}={int(code >= 5)}\n" for code in range(1, 8)),
    "1000": var("Device type", U32, "ro", "0x00020192"),
    "1001": var("Error register", U8, "ro", mappable=True),
    **record(0x1003, "Pre-defined error field", *[var(f"Error {n}", U32, "ro") for n in (1, 2, 3)]),
    "1003sub0": var("Number of errors", U8, "rw"),
    "1005": var("COB-ID SYNC", U32, default="0x80"),
    "1006": var("Communication cycle period", U32),
    "1007": var("Synchronous window length", U32),
    "1008": var("Device name", STRING, "const", "hilbench test device"),
    **record(0x1010, "Store parameters", *[var(f"Store {n}", U32) for n in (1, 2, 3)]),
    **record(0x1011, "Restore defaults", *[var(f"Restore {n}", U32) for n in (1, 2, 3)]),
    "1014": var("COB-ID EMCY", U32, default="$NODEID+0x80"),
    "1015": var("Inhibit time EMCY", U16),
    **record(0x1016, "Consumer heartbeat time", *[var(f"Consumer {n}", U32) for n in (1, 2, 3)]),
    "1017": var("Producer heartbeat time", U16),
    **record(0x1018, "Identity object", var("Vendor-ID", U32, "ro", "0x1234"), var("Product code", U32, "ro", "7")),
    "1019": var("Synchronous counter overflow value", U8),
    **record(0x1029, "Error behaviour", var("Communication error", U8)),
    **communication(0x1400, "$NODEID+0x200", 1),
    **communication(0x1401, "$NODEID+0x300", 255),
    **mapping(0x1600, "0x60400010", "0x60FF0020"),
    **mapping(0x1601, "0x60710010"),
    **communication(0x1800, "$NODEID+0x40000180", 1),
    **communication(0x1801, "$NODEID+0x40000280", 255),
    **mapping(0x1A00, "0x60410010", "0x60640020"),
    **mapping(0x1A01, "0x60770010"),
    "2000": var("Parameter", I16, default="-7", extra="LowLimit=-100\nHighLimit=100\n"),
    "2001": var("Write only", U8, "wo", ""),
    "2002": var("Text", STRING, "rw", "abc"),
    "2003": var("Blob", DOMAIN, "rw", ""),
    "2004": var("Odd width", I24, "rw", "-2", mappable=True),
    "2005": var("Flag", BOOLEAN, "rw", "1", mappable=True),
    "2006": var("Real", REAL32, "rw", "1.5", mappable=True),
    "6040": var("Controlword", U16, "rww", mappable=True),
    "6041": var("Statusword", U16, "ro", mappable=True),
    "6064": var("Position actual value", I32, "ro", mappable=True),
    "6071": var("Target torque", I16, "rww", mappable=True),
    "6077": var("Torque actual value", I16, "ro", mappable=True),
    "60FF": var("Target velocity", I32, "rww", mappable=True),
}


def eds_text(sections: Mapping[str, str] = SECTIONS) -> str:
    return "".join(f"[{name}]\n{options}\n" for name, options in sections.items())


class HandClock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.ns = 0

    def now_ns(self) -> int:
        return self.ns

    def tick(self) -> None:
        pass

    def expect_sync(self) -> None:
        pass

    def stalled_ns(self) -> int:
        return 0


class Direct:
    """No bus: what one side says the other has."""

    def there(self, frames: Sequence[Frame]) -> Sequence[Frame]:
        return frames

    back = there

    def close(self) -> None: ...


class Wire:
    """A bus between the test and the device, each with a link of its own."""

    def __init__(self, bus: Bus) -> None:
        self._test, self._device = bus.open_link(), bus.open_link()

    def there(self, frames: Sequence[Frame]) -> Sequence[Frame]:
        """Frames of the test as the device gets them."""
        return _carried(frames, self._test, self._device)

    def back(self, frames: Sequence[Frame]) -> Sequence[Frame]:
        """Frames of the device as the test gets them."""
        return _carried(frames, self._device, self._test)

    def close(self) -> None:
        self._test.close()
        self._device.close()


def _carried(frames: Sequence[Frame], sender: Link, receiver: Link) -> Sequence[Frame]:
    sender.send(frames)
    received: list[Frame] = []
    while len(received) < len(frames):
        arrived = receiver.receive(5.0)
        assert arrived, "a frame got lost"
        received += arrived
    return received


class Station:
    """A device on a clock set by hand, whose frames a test looks at."""

    def __init__(self, eds: Path, store: Path | None = None, wire: Direct | Wire | None = None) -> None:
        self.clock = HandClock()
        self._wire = wire or Direct()
        self.od = load_eds(eds, NODE)
        self.device = Device(self.od, NODE, self.clock, store=store)

    def booted(self) -> Self:
        """In PRE-OPERATIONAL, nothing left to be sent."""
        self.device.boot()
        self.frames()
        return self

    def started(self) -> Self:
        """In OPERATIONAL, nothing left to be sent."""
        self.booted()
        self.nmt(1)
        self.frames()
        return self

    def frames(self) -> list[tuple[int, str]]:
        """What it has said since the last look: identifier and data as hexadecimal digits."""
        said = [*self.device.replies, *self.device.outbox]
        self.device.replies.clear()
        self.device.outbox.clear()
        return [(frame.can_id, frame.data.hex()) for frame in self._wire.back(said)]

    def send(self, can_id: int, data: str | bytes = b"") -> list[tuple[int, str]]:
        """A frame from the bus, and what the device says to it."""
        sent = Frame(can_id, bytes.fromhex(data) if isinstance(data, str) else data)
        for frame in self._wire.there([sent]):
            self.device.handle(frame)
        return self.frames()

    def sync(self, data: bytes = b"") -> list[tuple[int, str]]:
        for frame in self._wire.there([Frame(self.device.sync_cob_id, data)]):
            self.device.sync(frame.data)
        return self.frames()

    def after(self, duration_ms: float) -> list[tuple[int, str]]:
        """Time passes."""
        self.clock.ns += int(duration_ms * 1e6)
        self.device.poll()
        return self.frames()

    def nmt(self, command: int, node: int = NODE) -> list[tuple[int, str]]:
        return self.send(0, bytes((command, node)))

    def sdo(self, request: str) -> str:
        """An SDO request that has exactly one answer."""
        [(can_id, answer)] = self.send(0x600 + NODE, request.replace(" ", ""))
        assert can_id == 0x580 + NODE
        return answer

    def write(self, index: int, sub: int, value: int, size: int) -> int:
        """Expedited download; 0, or the abort code."""
        data = value.to_bytes(size, "little", signed=value < 0).ljust(4, b"\0")
        head = bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, sub))
        answer = bytes.fromhex(self.sdo((head + data).hex()))
        return int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0

    def read(self, index: int, sub: int = 0) -> int:
        """Expedited upload of an unsigned value."""
        answer = bytes.fromhex(self.sdo(bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0)).hex()))
        assert answer[0] & 0xE3 == 0x43, answer.hex()
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little")

    def upload(self, index: int, sub: int) -> bytes | int:
        """Data of an object, expedited or in segments, or the abort code."""
        answer = bytes.fromhex(self.sdo(bytes((0x40, index & 0xFF, index >> 8, sub, 0, 0, 0, 0)).hex()))
        if answer[0] == 0x80:
            return int.from_bytes(answer[4:], "little")
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        data, toggle, last = b"", 0x00, False
        while not last:
            segment = bytes.fromhex(self.sdo(bytes((0x60 | toggle, *bytes(7))).hex()))
            assert segment[0] & 0xF0 == toggle
            data += segment[1 : 8 - (segment[0] >> 1 & 7)]
            toggle, last = toggle ^ 0x10, bool(segment[0] & 0x01)
        assert len(data) == int.from_bytes(answer[4:], "little")
        return data


class DeviceUnderTest(Station):
    """A device with an object of each kind, none of them behind an application."""

    def __init__(
        self,
        folder: Path,
        *,
        store: Path | None = None,
        sections: Mapping[str, str] = SECTIONS,
        wire: Direct | Wire | None = None,
    ) -> None:
        path = folder / "device.eds"
        path.write_text(eds_text(sections), encoding="ascii")
        super().__init__(path, store, wire)


class DriveUnderTest(Station):
    """The simulated servo drive."""

    def __init__(self, store: Path | None = None, wire: Direct | Wire | None = None) -> None:
        super().__init__(SERVO_EDS, store, wire)
        SimulatedDrive(self.device, MotorPort())
