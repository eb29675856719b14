"""Target of a stream, as typed on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

from hilbench.errors import UnusableInputError

#: Entry points of the sinks of other packages, by kind.
SINKS: Final = "hilbench.sinks"
_LOOPBACK: Final = "127.0.0.1"
#: The ports at which these tools look unless told otherwise.
_PORTS: Final = {"foxglove": 8765, "plotjuggler": 9870, "mqtt": 1883}
_EXPECTED: Final = "expected FILE.mcap, foxglove, plotjuggler or mqtt, the last three with :HOST:PORT where need be"


@dataclass(frozen=True)
class Target:
    """A file, a host and port (without one named this machine alone), or the address of a sink of another package."""

    kind: str
    path: Path = Path()
    host: str = _LOOPBACK
    port: int = 0
    address: str = ""  #: for a sink of another package, what stands behind the colon

    @property
    def may_wait(self) -> bool:
        """True if a bench without a real-time clock waits for it: a file has to be complete; viewers may miss some."""
        return self.kind == "mcap"

    def __str__(self) -> str:
        if self.kind == "mcap":
            return str(self.path)
        return f"{self.kind} {self.host}:{self.port}" if self.kind in _PORTS else f"{self.kind} {self.address}".strip()


def parse_target(text: str) -> Target:
    """``run.mcap``, ``foxglove``, ``plotjuggler:9871``, ``mqtt:192.168.1.5:1883``, ``foxglove:[::1]:8765``.

    Raises UnusableInputError.
    """
    if text.lower().endswith(".mcap"):
        return Target("mcap", path=Path(text))
    given, _, address = text.partition(":")
    if given in _PORTS:
        host, port = _address(address, text)
        return Target(given, host=host or _LOOPBACK, port=_PORTS[given] if port is None else port)
    if entry_points(group=SINKS, name=given):
        return Target(given, address=address)
    raise UnusableInputError(f"--stream {text}", _EXPECTED)


def _address(text: str, whole: str) -> tuple[str, int | None]:
    """Host and port of ``HOST:PORT``, ``HOST``, ``PORT`` or ``[IPv6]:PORT``."""
    if not text:
        return "", None
    host, colon, port = text.rpartition(":")
    if text.endswith("]") or (not colon and not text.isdecimal()):
        host, port = text, ""
    if port and (not port.isdecimal() or not 0 < int(port) < 65536):
        raise UnusableInputError(f"--stream {whole}", f"port '{port}', expected 1 to 65535")
    return host.strip("[]"), int(port) if port else None
