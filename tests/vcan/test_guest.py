"""What ends a guest of `make test-vcan`: its own time, or that it shows no sign of life; not the time of the host."""

from __future__ import annotations

import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tools.vcan_guest import guest


@pytest.fixture(autouse=True)
def _looked_at_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guest, "LOOK_S", 0.05)


@contextmanager
def watched(folder: Path, limit_s: float) -> Iterator[guest.Watch]:
    """A process that never ends, in the guest's place."""
    process = subprocess.Popen(["sleep", "1000"], text=True)
    watch = guest.Watch("guest", process, folder / "alive", limit_s)
    thread = threading.Thread(target=watch.run)
    thread.start()
    try:
        yield watch
    finally:
        watch.over.set()
        thread.join()
        process.kill()
        process.wait()


def test_a_guest_is_ended_when_its_own_time_is_over_however_soon(tmp_path: Path) -> None:
    with watched(tmp_path, 100.0) as watch:
        (tmp_path / "alive").write_text("101.5\n")
        assert watch.process.wait(60) != 0
    assert watch.ended.startswith("more than 100 s of its own time")


def test_a_guest_that_is_slow_goes_on(tmp_path: Path) -> None:
    with watched(tmp_path, 1.0) as watch:
        (tmp_path / "alive").write_text("0.5\n")
        with pytest.raises(subprocess.TimeoutExpired):
            watch.process.wait(0.5)
    assert watch.ended == ""


def test_a_guest_without_a_sign_of_life_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guest, "SILENT_S", 0.1)
    with watched(tmp_path, 100.0) as watch:
        assert watch.process.wait(60) != 0
    assert watch.ended.startswith("no sign of life")


def test_who_waits_is_told_how_far_a_silent_guest_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(guest, "WORDS_EVERY_S", 0.1)
    (tmp_path / "alive").write_text("42.0\n")
    said, deadline_s = "", time.monotonic() + 30.0
    with watched(tmp_path, 100.0):
        while "guest: (42 s of its own time in " not in said:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
            said += capsys.readouterr().out
