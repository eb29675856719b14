"""Frames that a CAN interface lost before any socket got them: the controller was not read in time.

No socket counts them; the interface does (Linux, Documentation/ABI/testing/sysfs-class-net-statistics).
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

SYSFS = Path("/sys/class/net")
_COUNTERS = ("rx_over_errors", "rx_dropped")  # overruns of the controller, frames for which the kernel had no room


class InterfaceLosses:
    """Counts from the moment it is made; 0 where the interface has no such statistics.

    An overrun counts once, although more than one frame may have been lost in it.
    """

    def __init__(self, channel: str) -> None:
        paths = [SYSFS / channel / "statistics" / name for name in _COUNTERS]
        self._files = [os.open(path, os.O_RDONLY | os.O_CLOEXEC) for path in paths if path.exists()]
        self._latest = self._before = sum(self._read(file) for file in self._files)

    def count(self) -> int:
        """Losses so far; the last known ones when the interface no longer exists."""
        with contextlib.suppress(OSError):  # unplugged
            self._latest = sum(self._read(file) for file in self._files)
        return self._latest - self._before

    def close(self) -> None:
        """Close the files; `count` must not be called any more."""
        for file in self._files:
            os.close(file)

    @staticmethod
    def _read(file: int) -> int:
        return int(os.pread(file, 32, 0))
