"""The CAN network interfaces of this machine."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

SYSFS = Path("/sys/class/net")
_ARPHRD_CAN = 280  # <linux/if_arp.h>
_IFF_UP = 0x1  # <linux/if.h>


def can_interfaces_up() -> list[str]:
    """Names of those that are up, vcan too."""
    found = []
    for folder in sorted(SYSFS.iterdir()) if SYSFS.is_dir() else ():
        with suppress(OSError, ValueError):  # it is just being removed
            if _number(folder / "type") == _ARPHRD_CAN and _number(folder / "flags") & _IFF_UP:
                found.append(folder.name)
    return found


def _number(path: Path) -> int:
    return int(path.read_text(encoding="ascii").strip(), 0)
