"""Open a bus by its name: ``embedded``, ``embedded:NAME``, ``socketcan:vcan0``, any ``interface:channel``."""

from __future__ import annotations

import hashlib
import os
import re
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from hilbench.can import claims, hub_client
from hilbench.can.embedded import EmbeddedLink
from hilbench.can.link import Link
from hilbench.can.protocol import DEFAULT_BITRATE, DEFAULT_CHANNEL, is_channel, is_path, socket_path
from hilbench.can.python_can import can
from hilbench.can.socketcan import SocketCanLink
from hilbench.errors import BusError, UnusableInputError, one_line

_READABLE = 32  # letters of a folder's name in that of its bus


@dataclass(frozen=True)
class BusAddress:
    """Address of a bus. `bitrate` in bit/s; `timing` (embedded bus only): "real" or "virtual" (`plugin.EmbeddedBus`).

    The channel of an embedded bus is its name, or the path of a hub's socket. ``embedded`` alone names none (channel
    ""): `in_folder` and `as_it_runs` find the bus meant.
    """

    interface: str = "embedded"
    channel: str = DEFAULT_CHANNEL
    bitrate: int = DEFAULT_BITRATE
    timing: str = "real"

    def __post_init__(self) -> None:
        if self.timing not in ("real", "virtual"):
            raise UnusableInputError("bus", f"timing {self.timing!r}, expected 'real' or 'virtual'")

    @classmethod
    def parse(cls, text: str, *, bitrate: int = DEFAULT_BITRATE, timing: str = "real") -> BusAddress:
        """The address in ``interface:channel``. Raises UnusableInputError if there is none."""
        interface, _, channel = text.strip().partition(":")
        if interface == "hilbench":  # the embedded bus' name among python-can's interfaces
            interface = "embedded"
        if not interface or (not channel and interface != "embedded"):
            raise UnusableInputError("bus", f"found {text!r}, expected embedded, embedded:NAME or INTERFACE:CHANNEL")
        if interface == "embedded":
            if channel and not is_channel(channel):
                raise UnusableInputError(
                    "bus", f"found {text!r}, expected a name of up to 48 letters, digits, '_', '-' or '.'"
                )
        elif interface not in can.VALID_INTERFACES:
            interfaces = ", ".join(sorted(can.VALID_INTERFACES - {"hilbench"}))
            raise UnusableInputError(
                "bus", f"found interface {interface!r}, expected embedded or one of python-can's: {interfaces}"
            )
        return cls(interface, channel, bitrate, timing)

    @property
    def is_named(self) -> bool:
        """True if it names a bus."""
        return bool(self.channel)

    @property
    def place(self) -> str:
        """Address by which any program of this machine finds the bus; `parse` takes it."""
        return f"embedded:{socket_path(self.channel)}" if self.interface == "embedded" else str(self)

    def in_folder(self, folder: Path) -> BusAddress:
        """Itself, or where it has no name the embedded bus of a folder: that of all configs in it."""
        if self.is_named:
            return self
        path = os.fsencode(folder.resolve())
        readable = re.sub(r"[^A-Za-z0-9_.-]+", "_", folder.resolve().name).lstrip("_.-")[:_READABLE] or "bench"
        return replace(self, channel=f"{readable}-{hashlib.sha256(path).hexdigest()[:8]}")

    def as_it_runs(self) -> BusAddress:
        """Itself with bitrate and timing of the embedded bus of that name, where one runs.

        One that this user's program has made from another session (with another runtime directory) is found, too.
        Without a name it is the only one that runs. Raises UnusableInputError when there is none, or more than one.
        """
        if self.interface != "embedded":
            return self
        named = self if self.is_named else replace(self, channel=_the_only_one())
        found = named.channel
        if not hub_client.runs(found):
            elsewhere = (path for path in embedded_channels() if is_path(path) and Path(path).stem == named.channel)
            found = next(elsewhere, "")
        if not found:
            return named
        running = hub_client.statistics(found)
        if not running.stations:  # the first to join determines its settings
            return replace(named, channel=found)
        return BusAddress(self.interface, found, running.bitrate, running.timing)

    def __str__(self) -> str:
        return f"{self.interface}:{self.channel}" if self.is_named else self.interface


def embedded_channels() -> list[str]:
    """This user's embedded buses that run: names, and paths of the sockets in other runtime directories than ours."""
    here = hub_client.running_channels()
    known = {os.fspath(socket_path(name)) for name in here}
    elsewhere = {
        claimed.place.removeprefix("embedded:")
        for claimed in claims.holders(answer_s=0.0)
        if claimed.uid == os.getuid() and claimed.place.startswith("embedded:/")
    }
    return here + sorted(path for path in elsewhere - known if hub_client.runs(path))


def _the_only_one() -> str:
    running = embedded_channels()
    if len(running) != 1:
        which = "no embedded bus of this user runs" if not running else f"these run: {', '.join(running)}"
        raise UnusableInputError("--bus", f"found embedded without a name, and {which}; expected embedded:NAME")
    return running[0]


def starting(bus: BusAddress) -> AbstractContextManager[None]:
    """Start meanwhile the hub that a bus needs, where there is none: opening the bus waits less."""
    return hub_client.starting(bus.channel) if bus.interface == "embedded" else nullcontext()


def open_link(bus: BusAddress) -> Link:
    """A link for the cyclic path. Raises BusError, in one line, if the bus cannot be opened."""
    if bus.interface == "embedded":
        return EmbeddedLink(bus.channel, bus.bitrate, bus.timing)
    if bus.interface == "socketcan":
        return SocketCanLink(bus.channel)
    from hilbench.can.adapter import PythonCanLink

    return PythonCanLink(open_python_can(bus), bus.channel)


def open_python_can(bus: BusAddress, filters: can.typechecking.CanFilters | None = None) -> can.BusABC:
    """A python-can bus for configuration traffic. Raises BusError, in one line, if it cannot be opened."""
    from hilbench.can.plugin import EmbeddedBus

    try:
        if bus.interface == "embedded":
            return EmbeddedBus(bus.channel, filters, bitrate=bus.bitrate, timing=bus.timing)
        return can.Bus(channel=bus.channel, interface=bus.interface, bitrate=bus.bitrate, can_filters=filters)
    except can.CanInterfaceNotImplementedError as error:
        raise BusError(f"{bus}: {one_line(error)}, expected one of python-can's interfaces") from error
    except (can.CanError, OSError, ValueError, TypeError, NameError, ImportError) as error:
        raise BusError(f"{bus}: {one_line(error)}") from error
