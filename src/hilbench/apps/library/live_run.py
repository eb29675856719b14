"""The folder of a run that goes on: found by the bus in its trace, read while it is written, and left alone."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Final, Self

from hilbench.canopen.identifiers import SYNC
from hilbench.results.journal import JournalReader
from hilbench.results.run_folder import RunFolder
from hilbench.results.trace import open_part, parts_of

_LOCKS: Final = Path("/proc/locks")
#: A trace without a result that was written to so lately is taken for one that is being written, where the system does
#: not tell whose lock is whose, s.
_LATELY_S: Final = 5.0
#: Of so many folders, the newest, each is looked at.
_LOOKED_AT: Final = 20
_BLOCK: Final = 1 << 20
_LINE: Final = 200
#: What is farther apart is not of one clock.
_NEAR_NS: Final = 2_000_000_000


def continues(folder: RunFolder) -> bool:
    """Asked of the kernel; the lock itself is not tried: its bench could miss it."""
    try:
        found = folder.trace.stat()
    except OSError:
        return False
    inode = f"{os.major(found.st_dev):02x}:{os.minor(found.st_dev):02x}:{found.st_ino}"
    try:
        if any(inode in line.split() for line in _LOCKS.read_text(encoding="ascii").splitlines()):
            return True
    except OSError:  # no /proc: the time must do
        pass
    return not folder.result.exists() and time.time() - found.st_mtime < _LATELY_S


@dataclass(frozen=True)
class LiveRun:
    """A run that its bench still writes, or that is played as if it did."""

    folder: RunFolder
    journal: JournalReader
    is_played: bool = False  #: it has ended, and is replayed from its trace

    @classmethod
    def on(cls, runs: Path, channel: str) -> Self | None:
        """The run in a folder of runs whose bench is on that bus, by the name of its channel in a trace; None: none."""
        newest = sorted(_folders(runs), key=lambda entry: entry[0], reverse=True)[:_LOOKED_AT]
        for _, path in newest:
            folder = RunFolder(path)
            if continues(folder) and _channel(folder.trace) == channel and folder.journal.exists():
                return cls(folder, JournalReader(folder.journal))
        return None

    @property
    def continues(self) -> bool:
        """True if the run still goes on."""
        return continues(self.folder)

    def cycles(self, sync_ns: int, cycle_ns: int) -> int:
        """SYNCs before one that was received at `sync_ns`, by its trace, which may be a little behind, or ahead."""
        wanted, count, rest, tail = f" {SYNC:03X}#".encode(), 0, b"", b""
        for part in parts_of(self.folder.trace):
            with open_part(part) as file:
                while block := file.read(_BLOCK):
                    text = rest + block
                    count += text.count(wanted)
                    rest = text[-len(wanted) + 1 :]
                    tail = tail[-_LINE:] + block
        last = tail.rfind(wanted)
        start = tail.rfind(b"(", 0, last)
        if last < 0 or start < 0:
            return count
        last_ns = int(Decimal(tail[start + 1 : tail.index(b")", start)].decode()) * 10**9)
        ahead = round((sync_ns - last_ns) / cycle_ns)
        return max(count - 1 + ahead, 0) if abs(ahead) * cycle_ns < _NEAR_NS else count


def _folders(runs: Path) -> list[tuple[float, Path]]:
    try:
        return [(entry.stat().st_mtime, Path(entry.path)) for entry in os.scandir(runs) if entry.is_dir()]
    except OSError:
        return []


def _channel(trace: Path) -> str:
    """Channel in the first line of a trace."""
    try:
        with open(trace, "rb") as file:
            words = file.readline(_BLOCK).split()
    except OSError:
        return ""
    return words[1].decode("utf-8", "replace") if len(words) > 1 else ""
