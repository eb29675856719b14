"""One bus has one master: whoever else would write to it is refused, and told who is there."""

from __future__ import annotations

import fcntl
import json
import os
import select
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from tests.bench.whole_runs import ENDLESS, bus_of, config, gone, run, run_folders, start, wait_for_frames
from tests.cli.in_process import hilbench

from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.canopen import master_guard
from hilbench.results.result import Result
from hilbench.runs.config import load

EDS = Path(__file__).resolve().parents[2] / "eds" / "hilbench_servo.eds"


#: Long enough to be there.
BRIEF = [{"hold": {"duration_s": 0.2}}]
#: A command that hears that its terminal closes, also where the tests run under nohup.
_HEARS_THE_END = ["env", "--default-signal=HUP"]


@pytest.mark.slow
def test_of_two_runs_that_start_in_the_same_moment_one_runs_and_one_is_refused(tmp_path: Path) -> None:
    path = config(tmp_path, steps=BRIEF)
    both = [start(path) for _ in range(2)]
    said = {process.returncode: err for process in both for _, err in [process.communicate(timeout=120)]}
    assert sorted(said) == [0, 2], said
    assert "bench web_section_step" in said[2]
    assert len(run_folders(path)) == 1
    assert gone(path)


@pytest.mark.slow
def test_nodes_that_run_already_are_named_with_how_to_use_them(tmp_path: Path) -> None:
    path = config(tmp_path)
    hardware = subprocess.Popen([sys.executable, "-m", "hilbench", "simulate-hardware", str(path)])
    try:
        wait_until_claimed(path, "node1")
        code, _, err = run(path)
        assert code == 2
        assert f"process {hardware.pid}" in err
        assert "--no-start" in err
        assert run_folders(path) == []
    finally:
        hardware.terminate()
        hardware.wait(30)
    assert gone(path)


def wait_until_claimed(path: Path, role: str) -> None:
    from hilbench.can.claims import holder

    place = load(path)[0].bus_address.place
    deadline_s = time.monotonic() + 60.0
    while holder(place, role) is None:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


@contextmanager
def foreign(path: Path, frame: Frame) -> Iterator[None]:
    """A program that knows nothing of hilbench sends a frame every 20 ms on the bus of a config."""
    address = load(path)[0].bus_address
    link, done = open_link(address), threading.Event()

    def send() -> None:
        while not done.wait(0.02):
            link.send([frame])

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
        link.close()


@pytest.mark.parametrize(
    ("frame", "received"),
    [
        (Frame(0x080, b""), "SYNC (080h"),
        (Frame(0x000, b"\x01\x07"), "NMT commands (000h"),
        (Frame(0x77F, b"\x05"), "node 127, which is the bench's own id (77Fh)"),
        (Frame(0x207, b"\x0f\x00"), "set points (RPDO 207h)"),
    ],
)
def test_a_foreign_master_is_heard_and_told_by_what_it_sends(tmp_path: Path, frame: Frame, received: str) -> None:
    path = config(tmp_path)
    with foreign(path, frame):
        done = hilbench("run", path, "--out", tmp_path / "runs")
        assert done.returncode == 2
        (line,) = done.stderr.strip().splitlines()
        assert received in line
        assert "--force" in line
        assert "bench is at work" not in line
        assert not (tmp_path / "runs").exists()
        scanned = json.loads(hilbench("scan", "--bus", bus_of(path), "--listen", "0.2", "--json").stdout)
        assert received in scanned["master"]
        refused_write = hilbench("sdo", "write", "1", "6040", "0", "--config", path)
        assert refused_write.returncode == 2
        assert received in refused_write.stderr


def test_a_node_that_answers_with_the_id_of_a_simulated_one_is_told(tmp_path: Path) -> None:
    path = config(tmp_path)
    link, done = open_link(load(path)[0].bus_address), threading.Event()

    def answer() -> None:
        while not done.is_set():
            for request in link.receive(0.02):
                if request.can_id == 0x602:
                    link.send([Frame(0x582, bytes.fromhex("4300100092010200"))])

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        for words in (("run", path, "--out", tmp_path / "runs"), ("simulate-hardware", path, "--pace", "lockstep")):
            refusal = hilbench(*words)
            assert refusal.returncode == 2
            assert "node 2 answers already" in refusal.stderr
        assert not (tmp_path / "runs").exists()
    finally:
        done.set()
        thread.join()
        link.close()


def test_a_private_embedded_bus_is_not_listened_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody can be on a bus that no program has open: a run in lockstep starts at once."""
    monkeypatch.setattr(master_guard, "open_link", lambda bus: pytest.fail("listened"))
    with master_guard.mastery(BusAddress.parse(bus_of(config(tmp_path))), 127, "bench"):
        pass


@pytest.mark.slow
def test_a_bench_that_was_killed_can_be_started_again_at_once(tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS)
    first = start(path)
    wait_for_frames(path, 100)
    first.kill()
    first.communicate()
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"steps": BRIEF}))
    code, out, err = run(path)
    assert code == 0, out + err
    assert gone(path)


@pytest.mark.parametrize("bus", ["embedded:two words", "socketcan:nocan99", "nosuch:x"])
def test_a_bus_that_cannot_be_is_exit_2_and_leaves_no_run_folder(tmp_path: Path, bus: str) -> None:
    path = config(tmp_path)
    done = hilbench("run", path, "--out", tmp_path / "runs", "--bus", bus)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "runs").exists()


@contextmanager
def terminal() -> Iterator[int]:
    """The end for a program; what it prints is read. It hangs up when the block is left."""
    ours, theirs = os.openpty()
    done = threading.Event()

    def read() -> None:
        while not done.is_set():
            if select.select([ours], [], [], 0.05)[0]:
                os.read(ours, 4096)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        yield theirs
    finally:
        done.set()
        reader.join()
        os.close(ours)


@pytest.mark.slow
def test_a_terminal_that_closes_stops_the_drives_as_sigterm_does(tmp_path: Path) -> None:
    path = config(tmp_path, steps=ENDLESS)
    command = [sys.executable, "-m", "hilbench", "run", str(path), "--out", str(tmp_path / "runs"), "--no-report"]
    with terminal() as theirs:
        process = subprocess.Popen(
            [*_HEARS_THE_END, *command],
            stdin=theirs,
            stdout=theirs,
            stderr=theirs,
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # its own: the kernel tells it of the end
        )
        os.close(theirs)
        folder = wait_for_frames(path, 300)
    assert process.wait(60) == 130
    faults = Result.read(folder / "result.json").faults
    assert [(fault.source, fault.text) for fault in faults] == [("operator", "interrupted, drives were stopped")]
    assert (folder / "recording.mf4").exists()
    assert gone(path)


def test_a_run_under_nohup_outlives_its_terminal() -> None:
    asks = "import signal; from hilbench.processes import end_signals; print(signal.SIGHUP in end_signals())"
    for before, expected in ((["nohup"], "False"), (_HEARS_THE_END, "True")):
        done = subprocess.run([*before, sys.executable, "-c", asks], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == expected
