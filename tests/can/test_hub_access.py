"""Who may onto the embedded bus, how it is found, and what its hub refuses."""

from __future__ import annotations

import os
import socket
import uuid
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from tests.can.embedded_links import REAL, VIRTUAL, collect, received

from hilbench.can import hub_client, protocol
from hilbench.can.claims import MASTER, claim
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.can.requests import Wanted
from hilbench.errors import BusError, UnusableInputError


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
    assert received(collect(b, 1)) == [(0x1, b"")]
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


def test_a_bus_that_runs_otherwise_is_refused(runtime: Any) -> None:
    link = open_link(VIRTUAL)
    with pytest.raises(BusError, match="bitrate is 1000000 bit/s on the bus that runs, asked for 500000"):
        open_link(BusAddress(timing="virtual", bitrate=500_000))
    with pytest.raises(BusError, match="timing is virtual") as refused:  # as of a run beside a monitor before it
        open_link(REAL)
    assert f"(process {os.getpid()}); expected these ended, or of the same bit rate and --pace" in str(refused.value)
    link.close()
    again = open_link(BusAddress(bitrate=500_000))  # nobody is on it any more
    assert hub_client.statistics(REAL.channel).bitrate == 500_000
    again.close()


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
