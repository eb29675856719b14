"""Who says that a bus is his: processes that claim it, are stopped, are killed, and ask."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from hilbench.can import claims
from hilbench.can.claims import MASTER, TakenError, claim, holder, holders

#: Claims the bus that it is given, says so, and waits; or says who has it.
CLAIMANT = """
import sys, time
from hilbench.can.claims import TakenError, claim
try:
    with claim(sys.argv[1], {"master": "a bus without a master"}, "bench of a test", bitrate=500_000):
        print("mine", flush=True)
        sys.stdin.read()
except TakenError as error:
    print(error, flush=True)
"""

Start = Callable[[str], "subprocess.Popen[str]"]


@pytest.fixture
def place() -> str:
    return f"socketcan:{uuid.uuid4().hex[:12]}"


@pytest.fixture
def start() -> Iterator[Start]:
    """Starts a claimant, with nothing of an environment and in a session of its own."""
    running = []

    def claimant(place: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-c", CLAIMANT, place],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={"PATH": os.environ["PATH"]},
            cwd="/",
            start_new_session=True,
        )
        running.append(process)
        return process

    yield claimant
    for process in running:
        process.kill()
        process.communicate()


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def eventually_free(place: str) -> bool:
    deadline_s = time.monotonic() + 20.0
    while holder(place, MASTER) is not None:
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.02)
    return True


def test_whoever_comes_second_is_told_who_is_there(place: str, start: Start) -> None:
    first = start(place)
    assert said(first) == "mine"
    found = holder(place, MASTER)
    assert found is not None
    assert (found.pid, found.uid, found.place, found.bitrate) == (first.pid, os.getuid(), place, 500_000)
    second = said(start(place))
    for text in (place, "bench of a test", f"process {first.pid}", "since", "expected a bus without a master"):
        assert text in second
    assert "\n" not in str(found)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_a_process_that_dies_in_any_way_leaves_its_bus_free(place: str, start: Start, number: int) -> None:
    first = start(place)
    assert said(first) == "mine"
    first.send_signal(number)
    assert eventually_free(place)
    assert said(start(place)) == "mine"


def test_a_process_that_was_stopped_is_still_there_and_named(place: str, start: Start) -> None:
    first = start(place)
    assert said(first) == "mine"
    first.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, first.pid, os.WSTOPPED | os.WNOWAIT)  # it may still answer until it really stands
    found = holder(place, MASTER)
    assert found is not None
    assert (found.pid, found.place) == (first.pid, place)
    assert [one.place for one in holders(0.0) if one.pid == first.pid] == [place]
    second = said(start(place))
    assert f"process {first.pid}" in second
    first.send_signal(signal.SIGCONT)
    assert holder(place, MASTER) != found  # now it says more of itself


def test_of_many_that_start_in_the_same_moment_exactly_one_wins(place: str, start: Start) -> None:
    with ThreadPoolExecutor(8) as pool:
        words = list(pool.map(said, [start(place) for _ in range(8)]))
    assert words.count("mine") == 1
    assert all("expected a bus without a master" in word for word in words if word != "mine")


def test_two_in_one_process_and_another_bus(place: str) -> None:
    with (
        claim(place, {MASTER: "nobody"}, "one"),
        claim(f"{place}x", {MASTER: "nobody"}, "another"),
        pytest.raises(TakenError, match=f"one.*process {os.getpid()}"),
        claim(place, {MASTER: "nobody"}, "two"),
    ):
        pass
    assert holder(place, MASTER) is None


def test_roles_are_held_together_or_not_at_all(place: str) -> None:
    with claim(place, {"node3": "nobody"}, "hardware"):
        with pytest.raises(TakenError, match="hardware"), claim(place, {"node2": "-", "node3": "-"}, "another"):
            pass
        assert holder(place, "node2") is None


def test_a_bus_whose_name_is_longer_than_the_kernel_takes(place: str) -> None:
    long = f"{place}{'x' * 150}"
    with claim(long, {MASTER: "nobody"}, "one"):
        assert [one.place for one in holders() if one.place.startswith(place)] == [long]
        assert holder(f"{long}y", MASTER) is None


def test_what_another_program_says_cannot_upset_who_asks(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for words in (b"", b"[]", b'{"what": 3, "since_s": "now", "bitrate": 1e99}', b'{"what": "\\u001b[2J\\n"}', b"\xff"):
        monkeypatch.setattr(claims, "_own_words", lambda *_, said=words: said)
        with claim(place, {MASTER: "nobody"}, ""):
            with pytest.raises(TakenError) as caught, claim(place, {MASTER: "nobody"}, ""):
                pass
            assert str(caught.value).isprintable()
            assert f"process {os.getpid()}" in str(caught.value)
