"""CAN network interfaces of this machine, by sysfs: those that are up, and the frames that they lost."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

SYSFS = Path("/sys/class/net")
ARPHRD_CAN = 280  # <linux/if_arp.h>
IFF_UP = 0x1  # <linux/if.h>
_COUNTERS = ("rx_over_errors", "rx_dropped")  # overruns of the controller, frames for which the kernel had no room


def can_interfaces_up() -> list[str]:
    """Names of those that are up, vcan too."""
    found = []
    for folder in sorted(SYSFS.iterdir()) if SYSFS.is_dir() else ():
        with suppress(OSError, ValueError):  # it is just being removed
            if number_in(folder / "type") == ARPHRD_CAN and number_in(folder / "flags") & IFF_UP:
                found.append(folder.name)
    return found


def number_in(path: Path) -> int:
    """Number that the kernel has written there."""
    return int(path.read_text(encoding="ascii").strip(), 0)


class InterfaceLosses:
    """Frames lost before any socket got them, from the moment it is made; 0 where there are no such statistics.

    The interface counts them (Linux, Documentation/ABI/testing/sysfs-class-net-statistics). An overrun counts once,
    although more than one frame may have been lost in it.
    """

    def __init__(self, channel: str) -> None:
        paths = [SYSFS / channel / "statistics" / name for name in _COUNTERS]
        self._files = [os.open(path, os.O_RDONLY | os.O_CLOEXEC) for path in paths if path.exists()]
        self._latest = self._before = sum(self._read(file) for file in self._files)

    def count(self) -> int:
        """Losses so far; the last known ones when the interface no longer exists."""
        with suppress(OSError):  # unplugged
            self._latest = sum(self._read(file) for file in self._files)
        return self._latest - self._before

    def close(self) -> None:
        """Close the files; `count` must not be called any more."""
        for file in self._files:
            os.close(file)

    @staticmethod
    def _read(file: int) -> int:
        return int(os.pread(file, 32, 0))
