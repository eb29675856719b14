"""Every test of the embedded bus gets a runtime directory of its own, and leaves no hub behind."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.can.embedded_links import Start

from hilbench.can.open import BusAddress


class Runtime:
    """A directory for the embedded bus' sockets, and what goes on there."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def hubs(self) -> list[int]:
        """Process ids of the hubs that serve sockets here."""
        found = []
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    words = (entry / "cmdline").read_bytes().split(b"\0")
                except OSError:  # it has just ended
                    continue
                if b"hilbench.can.hub" in words and bytes(self.folder) in words:
                    found.append(int(entry.name))
        return found

    @staticmethod
    def eventually(condition: Callable[[], bool]) -> bool:
        """Whether `condition` comes true; gives a busy machine plenty of time."""
        deadline = time.monotonic() + 20
        while not condition():
            if time.monotonic() > deadline:
                return False
            time.sleep(0.02)
        return True


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Runtime]:
    """A runtime directory; afterwards no hub runs and no socket is left. (Its name is short: socket paths are.)"""
    base = Path(tempfile.mkdtemp(prefix="hb", dir="/tmp"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    there = Runtime(base / "hilbench")
    yield there
    monkeypatch.undo()
    try:
        assert there.eventually(lambda: not there.hubs()), "a hub outlived its clients"
        assert not list(there.folder.glob("*.sock"))
        assert not list(there.folder.glob("*.log"))
    finally:
        shutil.rmtree(base)


@pytest.fixture
def start(runtime: Runtime) -> Iterator[Start]:
    """Run a program in a process of its own; ended with the test."""
    children: list[subprocess.Popen[bytes]] = []

    def start(code: str, *arguments: str) -> subprocess.Popen[bytes]:
        children.append(subprocess.Popen([sys.executable, "-c", code, *arguments]))
        return children[-1]

    yield start
    for child in children:
        child.kill()
        child.wait()


@pytest.fixture(params=["virtual", "real"])
def address(request: pytest.FixtureRequest) -> BusAddress:
    return BusAddress(timing=request.param)
