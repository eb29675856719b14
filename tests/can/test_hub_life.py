"""The hub of the embedded bus as a process: who starts it, what ends it, and what does not."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest
from tests.can.embedded_links import LISTENER, REAL, VIRTUAL, Start, collect

from hilbench.can import hub_client, protocol
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.open import open_link, starting
from hilbench.errors import BusError


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
        assert runtime.eventually(runtime.hubs)  # while its starter hands over to it neither may be listed
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


def test_the_hub_needs_only_the_standard_library(runtime: Any) -> None:
    """It starts without site-packages: so it starts fast, whatever is installed."""
    link = open_link(VIRTUAL)
    (hub,) = runtime.hubs()
    words = Path(f"/proc/{hub}/cmdline").read_bytes().split(b"\0")
    assert b"-S" in words
    maps = Path(f"/proc/{hub}/maps").read_text()
    assert "site-packages" not in maps
    link.close()
