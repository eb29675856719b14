"""The gateway as its clients see it: lines over TCP, on a bus with simulated drives (CiA 309-3, ASCII mapping)."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli.drives import bus, sdo
from tests.cli.in_process import hilbench

from hilbench.apps.gateway.requests import form
from hilbench.apps.gateway.server import event_of
from hilbench.apps.gateway.session import Session
from hilbench.can.frame import Frame
from hilbench.errors import BusError

__all__ = ["bus"]

Started = Callable[..., tuple[str, int]]


class Client:
    """A program that speaks the gateway's lines."""

    def __init__(self, port: int) -> None:
        self._connection = socket.create_connection(("127.0.0.1", port), timeout=20.0)
        self._lines = self._connection.makefile("rb")
        self.events: list[str] = []

    def ask(self, line: str) -> str:
        self._connection.sendall(line.encode() + b"\r\n")
        while (answer := self.line()).startswith("1 "):
            self.events.append(answer)
        return answer

    def line(self) -> str:
        read = self._lines.readline().decode()
        assert read.endswith("\r\n")
        return read[:-2]

    def until(self, event: str) -> None:
        while event not in self.events:
            self.events.append(self.line())

    def close(self) -> None:
        self._lines.close()
        self._connection.close()


@pytest.fixture(scope="module")
def start() -> Iterator[Started]:
    """Starts a gateway on a bus: what it says, and its port."""
    running = []

    def started(bus: str, *options: str) -> tuple[str, int]:
        process = subprocess.Popen(
            [sys.executable, "-m", "hilbench", "gateway", "--bus", bus, "--port", "0", *options],
            stdout=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        assert process.stdout is not None
        said = process.stdout.readline()
        found = re.search(r"127\.0\.0\.1:(\d+)", said)
        assert found is not None, said
        return said, int(found[1])

    yield started
    for process in running:
        process.terminate()
    for process in running:
        assert process.wait(timeout=20) == 0


@pytest.fixture(scope="module")
def port(bus: str, start: Started) -> int:
    said, port = start(bus)
    assert "clients may write" in said
    return port


@pytest.fixture
def client(port: int) -> Iterator[Client]:
    connected = Client(port)
    yield connected
    connected.close()


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("[1] 5 read 0x1018 2 u32", "[1] 1026"),
        ("[2] 5 r 0x1018 2 x32", "[2] 0x00000402"),
        ("[3] 1 5 r 0x1018 2", "[3] 02 04 00 00"),
        ("[4] 5 r 0x1008 0 vs", '[4] "hilbench servo"'),
        ("[5] 5 start", "[5] OK"),
        ("[6] 5 preop", "[6] OK"),
        ("[7] info version", "[7] 0 0 0 0 2 2.1 0.1.0"),
    ],
)
def test_requests_are_answered(client: Client, line: str, answer: str) -> None:
    assert client.ask(line) == answer


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("0x6085 0 u32 4000", {"u32  # what it is now": "4000", "d": "oA8AAA=="}),
        ("0x6071 0 i16 -20", {"i16": "-20", "x16": "0xFFEC"}),
    ],
)
def test_what_is_written_is_read(client: Client, written: str, read: dict[str, str]) -> None:
    place = written[:8]
    assert client.ask(f"[1] 5 w {written}") == "[1] OK"
    assert {form: client.ask(f"[2] 5 r {place} {form}") for form in read} == {
        form: f"[2] {answer}" for form, answer in read.items()
    }


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("[1] 5 r 0x2FFF 0 u32", "[1] ERROR:0x06020000 "),  # no such object
        ("[1] 5 w 0x6041 0 u16 0", "[1] ERROR:0x06010002 "),  # read-only
        ("[1] 5 r 0x1018 2 u16", "[1] ERROR:0x06070010 "),  # another length
        ("[1] 99 r 0x1018 2 u32", "[1] ERROR:0x05040000 "),  # nobody there
        ("[1] 5 r 0x1018 2 u33", "[1] ERROR:101 "),
        ("[1] 5 r 0x1018", "[1] ERROR:101 "),
        ("[1] 5 w 0x6085 0 u32 many", "[1] ERROR:101 "),
        ("[1] 5 w 0x6085 0 u8 256", "[1] ERROR:101 "),
        ("[1] 5 reset it", "[1] ERROR:101 "),
        ("[1] 5", "[1] ERROR:101 "),
        ("5 start", "[0] ERROR:101 "),
        ('[1] 5 w 0x1008 0 vs "half', "[1] ERROR:101 "),
        ("[1] 5 dance", "[1] ERROR:100 "),
        ("[1] read 0x1018 2 u32", "[1] ERROR:105 "),
        ("[1] 2 5 start", "[1] ERROR:106 "),
        ("[1] 200 start", "[1] ERROR:107 "),
        ("[1] set network 2", "[1] ERROR:106 "),
        ("[1] lss_conf_bitrate 0 5", "[1] ERROR:503 "),
    ],
)
def test_what_cannot_be_done_has_the_standards_code(client: Client, line: str, error: str) -> None:
    assert client.ask(line).startswith(error)


LONG = "1" * 4301


@pytest.mark.parametrize(
    "line",
    [
        f"[{LONG}] info version",
        f"[1] {LONG} start",
        f"[1] {LONG} 5 start",
        f"[1] set node {LONG}",
        f"[1] 5 r {LONG} 0 u32",
        f"[1] 5 w 0x6085 0 u32 {LONG}",
        f"[1] 5 w 0x6085 0 r32 {LONG}",
        f"[1] 5 w 0x6085 0 t {LONG} 1",
        "[1] 5 w 0x6085 0 t 1 4294967296",
        "[1] 5 w 0x6085 0 t 65536 1",
    ],
)
def test_a_number_that_no_field_holds_is_an_error_and_the_connection_stays(client: Client, line: str) -> None:
    assert re.match(r"\[[01]\] ERROR:101 # .{1,200}$", client.ask(line))
    assert client.ask("[2] info version").startswith("[2] 0 0 0 0")


def test_a_default_node_is_the_clients_own(port: int) -> None:
    first, second = Client(port), Client(port)
    assert first.ask("[1] set node 6") == "[1] OK"
    assert first.ask("[2] r 0x1018 2 u32") == "[2] 1026"
    assert second.ask("[3] r 0x1018 2 u32").startswith("[3] ERROR:105")
    first.close()
    second.close()


def test_all_clients_are_told_of_a_boot_up(port: int) -> None:
    first, second = Client(port), Client(port)
    second.ask("[1] info version")
    assert first.ask("[1] 6 reset node") == "[1] OK"
    first.until("1 6 BOOT_UP")
    second.until("1 6 BOOT_UP")
    first.close()
    second.close()


def test_devices_without_a_node_id_are_asked_for(client: Client) -> None:
    assert client.ask("[1] _lss_fastscan").startswith("[1] ERROR:103 # no device without a node id")
    assert client.ask("[2] lss_switch_sel 1 2 3 4").startswith("[2] ERROR:103")


def test_beside_a_gateway_nobody_else_writes_and_a_second_one_only_reads(bus: str, port: int, start: Started) -> None:
    assert port
    refused = sdo(bus, "write", 5, "6085", 4000)
    assert refused.returncode == 2
    assert "gateway" in refused.stderr
    said, second = start(bus)
    assert "clients may only read" in said
    client = Client(second)
    assert client.ask("[1] 5 r 0x1018 2 u32") == "[1] 1026"
    for line in ("[1] 5 w 0x6085 0 u32 4000", "[1] 5 start", "[1] lss_store"):
        assert client.ask(line).startswith("[1] ERROR:102 ")
    client.close()


def test_a_port_that_is_taken_is_said_in_one_line(bus: str, port: int) -> None:
    done = hilbench("gateway", "--bus", bus, "--port", str(port))
    assert done.returncode == 2
    assert f"127.0.0.1:{port} can't be served (Address already in use)" in done.stderr


def test_an_emcy_is_an_event_and_other_frames_are_none() -> None:
    emergency = Frame(0x85, bytes.fromhex("11 86 21 01 02 03 04 05"))
    assert event_of(emergency) == "1 5 EMCY 0x8611 33 01 02 03 04 05"
    assert event_of(Frame(0x705, b"\x05")) is None
    assert event_of(Frame(0x80, b"")) is None


class NoBus:
    """A bus that is lost."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        def lost(*_: object, **__: object) -> None:
            raise BusError("the bus is gone")

        return (lambda *_: None) if name == "why_not" else lost


@settings(max_examples=300)
@given(st.one_of(st.text(max_size=60), st.from_regex(r"\[\d+\] [a-z_ 0-9\"#x-]{0,40}", fullmatch=True)))
def test_whatever_a_client_sends_is_answered_in_one_line_or_not_at_all(line: str) -> None:
    answer = Session(NoBus(), NoBus).answer(line)  # type: ignore[arg-type] # a bus of which nothing is left
    assert answer is None or re.fullmatch(r"\[\d+\] (OK|0 0 0 0 .*|ERROR:\S+ # [^\n]*)", answer)


@given(st.sampled_from(["u8", "i16", "u32", "x32", "i64"]), st.data())
def test_a_value_is_read_as_it_was_shown(name: str, data: st.DataObject) -> None:
    bits, signed = int(name[1:]), name[0] == "i"
    value = data.draw(st.integers(-(1 << bits - 1) if signed else 0, (1 << bits - signed) - 1))
    sent = value.to_bytes(bits // 8, "little", signed=signed)
    assert form(name).parse(str(value)) == sent
    assert form(name).parse(form(name).show(sent)) == sent
