"""Sinks of a stream's samples: each kind with the library that its tool's makers keep."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

from hilbench.entry_points import loaded
from hilbench.errors import UnusableInputError
from hilbench.topology.signal_kinds import TIME, Signal

if TYPE_CHECKING:
    from hilbench.results.recording import Recording

#: Entry points of the sinks of other packages, by kind.
SINKS: Final = "hilbench.sinks"
_LOOPBACK: Final = "127.0.0.1"
#: The default ports of these tools.
_PORTS: Final = {"foxglove": 8765, "plotjuggler": 9870, "mqtt": 1883}
_EXPECTED: Final = "expected FILE.mcap, foxglove, plotjuggler or mqtt, the last three with :HOST:PORT where need be"
_NANOSECONDS: Final = 1e9
#: A broker gets a picture of the bench, not each cycle: at most one in so much bus time, s.
_MQTT_EVERY_S: Final = 0.1
#: Messages that wait for a broker that is away.
_MQTT_QUEUE: Final = 100


@dataclass(frozen=True)
class Target:
    """A file, a host and port (without one named this machine alone), or the address of a sink of another package."""

    kind: str
    path: Path = Path()
    host: str = _LOOPBACK
    port: int = 0
    address: str = ""  #: for a sink of another package, the text behind the colon

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


@dataclass(frozen=True)
class Group:
    """Signals of one message, and the place of each in a row."""

    name: str
    signals: Sequence[Signal]
    places: Sequence[int]

    @property
    def topic(self) -> str:
        """``/measured``."""
        return f"/{self.name}"

    def schema(self) -> dict[str, Any]:
        """JSON Schema of its messages, with units; a value that is not finite is null."""
        return {
            "type": "object",
            "title": f"hilbench.{self.name}",
            "properties": {
                TIME: {"type": "number", "unit": "s", "description": "experiment time, s"},
                **{
                    each.name: {
                        "type": "integer" if each.integer else "number",
                        "unit": each.unit or "1",
                        "description": f"{each.description}{f', {each.unit}' if each.unit else ''}",
                    }
                    for each in self.signals
                },
            },
        }

    def values(self, row: Sequence[float], t_s: float) -> dict[str, float | int | None]:
        """A message, as a program holds it."""
        found: dict[str, float | int | None] = {TIME: t_s}
        for signal, place in zip(self.signals, self.places, strict=True):
            value = row[place]
            found[signal.name] = None if not isfinite(value) else int(value) if signal.integer else value
        return found

    def text(self, row: Sequence[float], t_s: float) -> bytes:
        """Message as JSON; numbers as the shortest text that reads back as the same binary64."""
        return json.dumps(self.values(row, t_s), separators=(",", ":")).encode()


def groups_of(signals: Sequence[Signal]) -> list[Group]:
    """The groups of a bench's signals, time in each of them."""
    places = {signal.name: place for place, signal in enumerate(signals)}
    named = dict.fromkeys(signal.group for signal in signals if signal.name != TIME)
    return [
        Group(name, found, [places[signal.name] for signal in found])
        for name in named
        if (found := [signal for signal in signals if signal.group == name and signal.name != TIME])
    ]


def time_place(signals: Sequence[Signal]) -> int:
    """Place of the time in a row."""
    return next(place for place, signal in enumerate(signals) if signal.name == TIME)


def rows_of(data: bytes, width: int) -> Iterator[Sequence[float]]:
    """The rows of a piece of packed samples (binary64, in the machine's order)."""
    values = memoryview(data).cast("d")
    for at in range(0, len(values), width):
        yield values[at : at + width].tolist()


class Sink(Protocol):
    """Takes one row after the other; `close` makes what it writes whole."""

    def take(self, row: Sequence[float]) -> None:
        """The values of one cycle, in the order of the signals."""

    def close(self) -> None:
        """Close: there are no more samples."""


def open_sink(target: Target, signals: Sequence[Signal], bench: str, began_s: float) -> Sink:
    """Ready to take samples of a bench of this name; `began_s`: since 1970, to which the experiment time is added.

    A sink of another package is made by its entry point, of: address, signals, bench, began_s.

    Raises UnusableInputError for what can't be opened, or needs a library that is not installed.
    """
    match target.kind:
        case "mcap":
            return FoxgloveSink.file(target.path, signals, bench, began_s)
        case "foxglove":
            return FoxgloveSink.server(target, signals, bench, began_s)
        case "plotjuggler":
            return PlotJugglerSink(target, signals)
        case "mqtt":
            return MqttSink(target, signals, bench)
        case _:
            (entry, *_others) = entry_points(group=SINKS, name=target.kind)
            sink: Sink = loaded(entry)(target.address, signals, bench, began_s)
            return sink


def _imported(module: str, package: str, target: object) -> Any:
    """A module of an optional package."""
    try:
        return import_module(module)
    except ImportError:
        problem = f"needs {package}, expected 'pip install hilbench[streams]'"
        raise UnusableInputError(f"--stream {target}", problem) from None


class FoxgloveSink:
    """A channel a group, into an MCAP file or to Foxglove clients; by Foxglove's SDK for both."""

    def __init__(self, signals: Sequence[Signal], context: Any, end: Any, began_s: float) -> None:
        from foxglove import Channel

        self._context = context  # its channels close with it
        self._end, self._began_ns, self._time = end, round(began_s * _NANOSECONDS), time_place(signals)
        self._channels = [
            (group, Channel(group.topic, schema=_schema(group), message_encoding="json", context=context))
            for group in groups_of(signals)
        ]

    @classmethod
    def file(cls, path: Path, signals: Sequence[Signal], bench: str, began_s: float) -> FoxgloveSink:
        """An MCAP file, which must not be there yet. Raises UnusableInputError."""
        foxglove = _imported("foxglove", "foxglove-sdk", path)
        context = foxglove.Context()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            options = foxglove.mcap.MCAPWriteOptions(profile="hilbench", compression_threads=0)
            writer = foxglove.open_mcap(path, context=context, writer_options=options)
        except FileExistsError:
            raise UnusableInputError(path, "is there already, expected a new file") from None
        except (OSError, RuntimeError) as error:
            raise UnusableInputError(path, f"cannot be written ({error}), expected a new file") from error
        writer.write_metadata("hilbench", {"bench": bench})
        return cls(signals, context, writer.close, began_s)

    @classmethod
    def server(cls, target: Target, signals: Sequence[Signal], bench: str, began_s: float) -> FoxgloveSink:
        """A WebSocket server that only shows: who looks can send nothing. Raises UnusableInputError."""
        foxglove = _imported("foxglove", "foxglove-sdk", target)
        context = foxglove.Context()
        try:
            server = foxglove.start_server(
                name=f"hilbench {bench}", host=target.host, port=target.port, capabilities=[], context=context
            )
        except (OSError, RuntimeError) as error:
            raise UnusableInputError(f"--stream {target}", f"{error}, expected an address that is free") from error
        return cls(signals, context, server.stop, began_s)

    def take(self, row: Sequence[float]) -> None:
        """One message a channel."""
        t_s = row[self._time]
        time_ns = self._began_ns + round(t_s * _NANOSECONDS)
        for group, channel in self._channels:
            channel.log(group.text(row, t_s), log_time=time_ns)

    def close(self) -> None:
        """Complete the file, or end the server."""
        for _, channel in self._channels:
            channel.close()
        self._end()


def _schema(group: Group) -> Any:
    from foxglove import Schema

    text = json.dumps(group.schema(), ensure_ascii=False).encode()
    return Schema(name=f"hilbench.{group.name}", encoding="jsonschema", data=text)


class PlotJugglerSink:
    """A datagram a cycle for PlotJuggler's UDP server (protocol JSON): groups by name, `timestamp` in s."""

    def __init__(self, target: Target, signals: Sequence[Signal]) -> None:
        self._groups, self._time = groups_of(signals), time_place(signals)
        try:
            found = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_DGRAM)
            family, kind, protocol, _, address = found[0]
            self._address: Any = address
            self._socket = socket.socket(family, kind, protocol)
            self._socket.setblocking(False)
        except OSError as error:
            raise UnusableInputError(f"--stream {target}", f"{error.strerror}, expected a host and port") from error

    def take(self, row: Sequence[float]) -> None:
        """Send one datagram; no receiver is needed."""
        t_s = row[self._time]
        values = {group.name: group.values(row, t_s) for group in self._groups}
        data = json.dumps({"timestamp": t_s, **values}, separators=(",", ":")).encode()
        with suppress(OSError):  # no receiver, or the network is full: the next cycle comes soon
            self._socket.sendto(data, self._address)

    def close(self) -> None:
        """No more."""
        self._socket.close()


class MqttSink:
    """A message a group to a broker, ten times a second of bus time: ``hilbench/BENCH/measured``."""

    def __init__(self, target: Target, signals: Sequence[Signal], bench: str) -> None:
        mqtt = _imported("paho.mqtt.client", "paho-mqtt", target)
        self._groups, self._time = groups_of(signals), time_place(signals)
        self._below = f"hilbench/{re.sub(r'[^A-Za-z0-9_.-]+', '-', bench)}"
        self._next_s = float("-inf")
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.max_queued_messages_set(_MQTT_QUEUE)
        try:
            self._client.connect(target.host, target.port)
        except OSError as error:
            raise UnusableInputError(f"--stream {target}", f"{error}, expected a broker there") from error
        self._client.loop_start()

    def take(self, row: Sequence[float]) -> None:
        """A picture of the bench, when it is time for one."""
        t_s = row[self._time]
        if t_s < self._next_s:
            return
        self._next_s = t_s + _MQTT_EVERY_S
        for group in self._groups:
            self._client.publish(f"{self._below}/{group.name}", group.text(row, t_s))

    def close(self) -> None:
        """Send what was published, and disconnect."""
        self._client.disconnect()
        self._client.loop_stop()


def write_mcap(recording: Recording, path: Path) -> None:
    """Write it; a channel that no part has is in the group `other`. Raises UnusableInputError."""
    import numpy as np

    from hilbench.files import written_whole
    from hilbench.results.recording import NO_START_TIME
    from hilbench.topology.signals import find_signal, unit_of

    began = recording.start_time or NO_START_TIME
    names = list(recording.channels)
    signals = [find_signal(name) or Signal(name, unit_of(name), "", "other") for name in names]
    with written_whole(path) as partial:
        sink = FoxgloveSink.file(partial, signals, recording.comment, began.timestamp())
        for row in np.column_stack([np.asarray(recording[name], np.float64) for name in names]).tolist():
            sink.take(row)
        sink.close()
