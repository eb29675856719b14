"""The folder of a run that goes on: found by the bus in its trace, read while it is written, and left alone."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

from hilbench.canopen.identifiers import SYNC
from hilbench.results.journal import JournalReader
from hilbench.results.run_folder import RunFolder

#: Of so many folders, the newest, each is looked at.
_LOOKED_AT: Final = 20
_LOCKS: Final = Path("/proc/locks")
_BLOCK: Final = 1 << 20


@dataclass(frozen=True)
class RunUnderWay:
    """A run that its bench still writes."""

    folder: RunFolder
    journal: JournalReader

    @classmethod
    def on(cls, runs: Path, channel: str) -> Self | None:
        """The run in a folder of runs whose bench is on that bus, by the name of its channel in a trace; None: none."""
        newest = sorted(_folders(runs), key=lambda entry: entry[0], reverse=True)[:_LOOKED_AT]
        for _, path in newest:
            folder = RunFolder(path)
            if is_written(folder.trace) and _channel(folder.trace) == channel and folder.journal.exists():
                return cls(folder, JournalReader(folder.journal))
        return None

    def cycles(self) -> int:
        """SYNCs in its trace until now."""
        wanted, count, rest = f" {SYNC:03X}#".encode(), 0, b""
        with open(self.folder.trace, "rb") as file:
            while block := file.read(_BLOCK):
                text = rest + block
                count += text.count(wanted)
                rest = text[-len(wanted) + 1 :]
        return count


def is_written(trace: Path) -> bool:
    """Whether a process has the trace open for writing; it is asked of the kernel, no lock is tried."""
    try:
        found = trace.stat()
        inode = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}:{found.st_ino}"
        return any(inode in line.split() for line in _LOCKS.read_text(encoding="ascii").splitlines())
    except OSError:
        return False


def _folders(runs: Path) -> list[tuple[float, Path]]:
    try:
        return [(entry.stat().st_mtime, Path(entry.path)) for entry in os.scandir(runs) if entry.is_dir()]
    except OSError:
        return []


def _channel(trace: Path) -> str:
    """That of its first line."""
    try:
        with open(trace, "rb") as file:
            words = file.readline(_BLOCK).split()
    except OSError:
        return ""
    return words[1].decode("utf-8", "replace") if len(words) > 1 else ""
