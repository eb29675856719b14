"""Bus addresses, links over other python-can interfaces and SocketCAN, and errors in one line."""

from __future__ import annotations

import errno
import socket
import struct
from pathlib import Path
from typing import Any

import pytest

import can
from hilbench.can import interfaces
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.open import BusAddress, open_link, open_python_can
from hilbench.can.socketcan import SocketCanLink
from hilbench.errors import BusError, UnusableInputError


@pytest.mark.parametrize(
    ("text", "interface", "channel"),
    [
        ("embedded", "embedded", ""),
        ("embedded:line2", "embedded", "line2"),
        ("hilbench:line2", "embedded", "line2"),
        ("embedded:/run/user/1000/hilbench/line2.sock", "embedded", "/run/user/1000/hilbench/line2.sock"),
        ("socketcan:vcan0", "socketcan", "vcan0"),
        ("slcan:/dev/ttyUSB0@115200", "slcan", "/dev/ttyUSB0@115200"),
        ("udp_multicast:ff15:7079::1", "udp_multicast", "ff15:7079::1"),
    ],
)
def test_addresses(text: str, interface: str, channel: str) -> None:
    address = BusAddress.parse(text, bitrate=500_000, timing="virtual")
    assert address == BusAddress(interface, channel, 500_000, "virtual")
    assert BusAddress.parse(str(address), bitrate=500_000, timing="virtual") == address


@pytest.mark.parametrize("text", ["", "socketcan", "socketcan:", ":vcan0", " "])
def test_no_addresses(text: str) -> None:
    with pytest.raises(UnusableInputError, match="expected embedded, embedded:NAME or INTERFACE:CHANNEL"):
        BusAddress.parse(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "no_such_interface:x",
            "found interface 'no_such_interface', expected embedded or one of python-can's: .*pcan",
        ),
        ("embedded:two words", "found 'embedded:two words', expected a name of up to 48 letters"),
        ("embedded:../up", "expected a name of up to 48 letters"),
        ("embedded:/run/line2", "expected a name of up to 48 letters"),
    ],
)
def test_a_name_that_no_bus_can_have_is_told_before_anything_is_opened(text: str, said: str) -> None:
    with pytest.raises(UnusableInputError, match=said):
        BusAddress.parse(text)


def test_two_checkouts_have_two_buses_and_all_configs_of_a_folder_one(tmp_path: Path) -> None:
    unnamed = BusAddress.parse("embedded")
    folders = [tmp_path / name / "bench configs" for name in ("one", "two")]
    for folder in folders:
        folder.mkdir(parents=True)
    (tmp_path / "link").symlink_to(folders[0])
    one, two, again = (unnamed.in_folder(folder) for folder in (*folders, tmp_path / "link"))
    assert one == again != two
    assert one.channel.startswith("bench_configs-")
    assert BusAddress.parse(str(one)) == one
    named = BusAddress.parse("embedded:line2")
    assert named.in_folder(folders[0]) == named


def test_a_timing_that_is_none() -> None:
    with pytest.raises(UnusableInputError, match="'warp', expected 'real' or 'virtual'"):
        BusAddress.parse("embedded", timing="warp")


@pytest.mark.parametrize("text", ["socketcan:nocan99", "serial:/dev/nowhere"])
def test_what_cannot_be_opened_is_one_line(text: str) -> None:
    address = BusAddress.parse(text)
    for opener in (open_link, open_python_can):
        with pytest.raises(BusError) as caught:
            opener(address)
        assert "\n" not in str(caught.value)
        assert text.split(":")[0] in str(caught.value)


def test_a_link_over_another_python_can_interface() -> None:
    address = BusAddress.parse("virtual:adapter")
    a, b = open_link(address), open_link(address)
    sent = [Frame(0x123, b"\x01"), Frame(0x124 | REMOTE_FLAG, bytes(3)), Frame(0x1234567 | EXTENDED_FLAG, bytes(8))]
    a.send(sent)
    assert [(frame.can_id, frame.data) for frame in b.receive(1.0)] == [(frame.can_id, frame.data) for frame in sent]
    for filters, expected in (
        ([(0x123, 0x7FF | EXTENDED_FLAG)], [0x123]),
        ([(0x124 | REMOTE_FLAG, 0x7FF | REMOTE_FLAG)], [0x124 | REMOTE_FLAG]),
        ([], []),
        (None, [frame.can_id for frame in sent]),
    ):
        b.set_filters(filters)
        a.send(sent)
        assert [frame.can_id for frame in b.receive(0.0)] == expected
    assert b.receive(0.0) == []
    assert b.dropped is None  # python-can does not count
    a.close()
    b.close()
    b.close()
    with pytest.raises(BusError):
        b.send(sent)


def test_a_python_can_interface_without_descriptor() -> None:
    link = open_link(BusAddress.parse("virtual:adapter"))
    with pytest.raises(BusError, match="file descriptor"):
        link.fileno()
    link.close()


class KernelSocket:
    """What the kernel's CAN_RAW socket does, as far as the link uses it."""

    def __init__(self) -> None:
        self.bound: Any = None
        self.options: list[tuple[int, int, Any]] = []
        self.waiting: list[tuple[bytes, list[tuple[int, int, bytes]]]] = []
        self.sent: list[bytes] = []
        self.failures: list[int] = []
        self.lost = 0
        self.closed = False

    def setblocking(self, flag: bool) -> None:
        assert not flag

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        if option == 33:  # SO_RCVBUFFORCE without the privilege
            raise PermissionError(errno.EPERM, "Operation not permitted")
        self.options.append((level, option, value))

    def bind(self, address: tuple[str]) -> None:
        if address == ("gone0",):
            raise OSError(errno.ENODEV, "No such device")
        self.bound = address

    def recvmsg(self, size: int, ancillary: int) -> tuple[bytes, list[tuple[int, int, bytes]], int, None]:
        assert ancillary >= socket.CMSG_SPACE(16) + socket.CMSG_SPACE(4)
        if not self.waiting:
            raise BlockingIOError
        record, messages = self.waiting.pop(0)
        return record[:size], messages, 0, None

    def send(self, record: bytes) -> int:
        if self.failures:
            number = self.failures.pop(0)
            raise OSError(number, errno.errorcode[number])
        self.sent.append(record)
        return len(record)

    def getsockopt(self, level: int, option: int, size: int) -> bytes:
        assert (level, option, size) == (socket.SOL_SOCKET, 55, 36)  # SO_MEMINFO
        return struct.pack("=9I", *range(8), self.lost)

    def fileno(self) -> int:
        return -1 if self.closed else 3

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> KernelSocket:
    kernel = KernelSocket()

    def open_socket(family: int, kind: int, protocol: int) -> KernelSocket:
        assert (family, kind, protocol) == (socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        return kernel

    monkeypatch.setattr(socket, "socket", open_socket)
    return kernel


def record(can_id: int, data: bytes) -> bytes:
    return struct.pack("=IB3x8s", can_id, len(data), data)


def test_socketcan_receives_batches_times_and_the_drop_counter(kernel: KernelSocket) -> None:
    link = SocketCanLink("vcan0")
    assert kernel.bound == ("vcan0",)
    assert (socket.SOL_SOCKET, 40, 1) in kernel.options  # SO_RXQ_OVFL
    stamp = (socket.SOL_SOCKET, 35, struct.pack("@ll", 12, 345))
    kernel.waiting = [
        (record(0x181, b"\x01\x02"), [stamp]),
        (record(0x80, b""), [stamp, (socket.SOL_SOCKET, 40, struct.pack("=I", 7))]),
    ]
    assert link.receive(0.0) == [Frame(0x181, b"\x01\x02", 12_000_000_345), Frame(0x80, b"", 12_000_000_345)]
    assert link.dropped == 7


def test_socketcan_learns_of_losses_after_the_last_frame(kernel: KernelSocket) -> None:
    link = SocketCanLink("vcan0")
    kernel.lost = 3
    assert link.receive(0.0) == []
    assert link.dropped == 3
    kernel.lost = 4
    link.close()
    link.close()
    assert link.dropped == 4


def statistics(folder: Path, **counters: int) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, count in counters.items():
        (folder / name).write_text(f"{count}\n")


def test_socketcan_counts_what_the_interface_lost(
    kernel: KernelSocket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(interfaces, "SYSFS", tmp_path)
    statistics(tmp_path / "can0" / "statistics", rx_over_errors=85, rx_dropped=2, rx_errors=90)
    link = SocketCanLink("can0")
    link.receive(0.0)
    assert link.dropped == 0  # what was before is no loss of this link
    statistics(tmp_path / "can0" / "statistics", rx_over_errors=88, rx_dropped=3, rx_errors=99)
    kernel.lost = 10
    link.receive(0.0)
    assert link.dropped == 14
    statistics(tmp_path / "can0" / "statistics", rx_over_errors=89)
    link.close()
    assert link.dropped == 15


def test_socketcan_sends_in_order_and_waits_for_a_full_queue(kernel: KernelSocket) -> None:
    link = SocketCanLink("vcan0")
    kernel.failures = [errno.ENOBUFS, errno.ENOBUFS]
    link.send([Frame(0x181, b"\x01"), Frame(0x80, b"")])
    assert kernel.sent == [record(0x181, b"\x01"), record(0x80, b"")]
    kernel.failures = [errno.ENETDOWN]
    with pytest.raises(BusError, match="vcan0: is down"):
        link.send([Frame(0x80, b"")])


def test_socketcan_filters(kernel: KernelSocket) -> None:
    link = SocketCanLink("vcan0")
    for filters, packed in (
        ([(0x80, 0x7FF), (0x580, 0x780)], struct.pack("=IIII", 0x80, 0x7FF, 0x580, 0x780)),
        (None, bytes(8)),
        ([], b""),
    ):
        link.set_filters(filters)
        assert kernel.options[-1] == (socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)


def test_socketcan_names_an_interface_that_is_not_there(kernel: KernelSocket) -> None:
    with pytest.raises(BusError, match="socketcan:gone0: no such CAN interface"):
        SocketCanLink("gone0")


def test_a_kernel_without_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_can(*_: Any) -> None:
        raise OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol")

    monkeypatch.setattr(socket, "socket", no_can)
    with pytest.raises(BusError, match="socketcan:can0: this kernel has no CAN"):
        open_link(BusAddress.parse("socketcan:can0"))


def test_python_can_names_the_interface_plugin() -> None:
    assert "hilbench" in can.VALID_INTERFACES
