"""Open a bus by its name: ``embedded``, ``embedded:NAME``, ``socketcan:vcan0``, any ``interface:channel``."""

from __future__ import annotations

from dataclasses import dataclass

from hilbench.bus import hub_client
from hilbench.bus.embedded import EmbeddedLink
from hilbench.bus.link import Link
from hilbench.bus.protocol import DEFAULT_BITRATE, DEFAULT_CHANNEL
from hilbench.bus.python_can import can
from hilbench.bus.socketcan import SocketCanLink
from hilbench.errors import BusError, UnusableInputError


@dataclass(frozen=True)
class BusAddress:
    """Which bus. `bitrate` in bit/s; `timing` (embedded bus only): "real" or "virtual" (see `plugin.EmbeddedBus`)."""

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
        if interface == "embedded":
            channel = channel or DEFAULT_CHANNEL
        if not interface or not channel:
            raise UnusableInputError("bus", f"found {text!r}, expected embedded, embedded:NAME or INTERFACE:CHANNEL")
        return cls(interface, channel, bitrate, timing)

    def as_it_runs(self) -> BusAddress:
        """The same bus with bitrate and timing of the embedded bus of that name, where one runs."""
        if self.interface != "embedded" or self.channel not in hub_client.running_channels():
            return self
        running = hub_client.statistics(self.channel)
        return BusAddress(self.interface, self.channel, running.bitrate, running.timing)

    def __str__(self) -> str:
        return f"{self.interface}:{self.channel}"


def open_link(bus: BusAddress) -> Link:
    """A link for the cyclic path. Raises BusError, in one line, if the bus cannot be opened."""
    if bus.interface == "embedded":
        return EmbeddedLink(bus.channel, bus.bitrate, bus.timing)
    if bus.interface == "socketcan":
        return SocketCanLink(bus.channel)
    from hilbench.bus.adapter import PythonCanLink

    return PythonCanLink(open_python_can(bus), bus.channel)


def open_python_can(bus: BusAddress, filters: can.typechecking.CanFilters | None = None) -> can.BusABC:
    """A python-can bus for configuration traffic. Raises BusError, in one line, if it cannot be opened."""
    from hilbench.bus.plugin import EmbeddedBus

    try:
        if bus.interface == "embedded":
            return EmbeddedBus(bus.channel, filters, bitrate=bus.bitrate, timing=bus.timing)
        return can.Bus(channel=bus.channel, interface=bus.interface, bitrate=bus.bitrate, can_filters=filters)
    except can.CanInterfaceNotImplementedError as error:
        raise BusError(f"{bus}: {_one_line(error)}, expected one of python-can's interfaces") from error
    except (can.CanError, OSError, ValueError, TypeError, NameError, ImportError) as error:
        raise BusError(f"{bus}: {_one_line(error)}") from error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
