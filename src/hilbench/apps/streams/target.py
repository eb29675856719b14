"""Target of a stream, as typed on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from hilbench.errors import UnusableInputError

Kind = Literal["mcap", "foxglove", "plotjuggler", "mqtt"]

_LOOPBACK: Final = "127.0.0.1"
#: The ports at which these tools look unless told otherwise.
_PORTS: Final[dict[Kind, int]] = {"foxglove": 8765, "plotjuggler": 9870, "mqtt": 1883}
_EXPECTED: Final = "expected FILE.mcap, foxglove, plotjuggler or mqtt, the last three with :HOST:PORT where need be"


@dataclass(frozen=True)
class Target:
    """A file, or a host and port; without one named it is this machine alone."""

    kind: Kind
    path: Path = Path()
    host: str = _LOOPBACK
    port: int = 0

    @property
    def may_wait(self) -> bool:
        """True if a bench without a real-time clock waits for it: a file has to be complete; viewers may miss some."""
        return self.kind == "mcap"

    def __str__(self) -> str:
        return str(self.path) if self.kind == "mcap" else f"{self.kind} {self.host}:{self.port}"


def parse_target(text: str) -> Target:
    """``run.mcap``, ``foxglove``, ``plotjuggler:9871``, ``mqtt:192.168.1.5:1883``, ``foxglove:[::1]:8765``.

    Raises UnusableInputError.
    """
    if text.lower().endswith(".mcap"):
        return Target("mcap", path=Path(text))
    given, _, address = text.partition(":")
    for kind, usual in _PORTS.items():
        if given == kind:
            host, port = _address(address, text)
            return Target(kind, host=host or _LOOPBACK, port=usual if port is None else port)
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
