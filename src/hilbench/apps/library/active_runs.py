"""Whether a run still goes on: its bench has locked the trace that it writes."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Final

from hilbench.results.run_folder import RunFolder

_LOCKS: Final = Path("/proc/locks")
#: A trace without a result that was written to so lately is taken for one that is being written, where the system does
#: not tell whose lock is whose, s.
_LATELY_S: Final = 5.0


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
