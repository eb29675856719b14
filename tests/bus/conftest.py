"""Every test of the embedded bus gets a runtime directory of its own, and leaves no hub behind."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest


def hub_processes(folder: Path) -> list[int]:
    """Process ids of the hubs that serve sockets in `folder`."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                words = (entry / "cmdline").read_bytes().split(b"\0")
            except OSError:  # it has just ended
                continue
            if b"hilbench.bus.hub" in words and bytes(folder) in words:
                found.append(int(entry.name))
    return found


def eventually(condition: Callable[[], bool]) -> bool:
    """Whether `condition` comes true; gives a busy machine plenty of time."""
    deadline = time.monotonic() + 20
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The directory of the sockets; afterwards no hub runs and no socket is left. (Short: socket paths are.)"""
    base = Path(tempfile.mkdtemp(prefix="hb", dir="/tmp"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(base))
    folder = base / "hilbench"
    yield folder
    try:
        assert eventually(lambda: not hub_processes(folder)), "a hub outlived its clients"
        assert not list(folder.glob("*.sock"))
        assert not list(folder.glob("*.log"))
    finally:
        shutil.rmtree(base)
