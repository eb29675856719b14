"""Sinks of a stream's samples: each kind with the library that its tool's makers keep."""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final, Protocol

from hilbench.apps.streams.messages import Group, groups_of, time_place
from hilbench.apps.streams.target import SINKS, Target
from hilbench.entry_points import loaded
from hilbench.errors import UnusableInputError
from hilbench.topology.signal_kinds import Signal

_NANOSECONDS: Final = 1e9
#: A broker gets a picture of the bench, not each cycle: at most one in so much bus time, s.
_MQTT_EVERY_S: Final = 0.1
#: Messages that wait for a broker that is away.
_MQTT_QUEUE: Final = 100


class Sink(Protocol):
    """Takes one row after the other; `close` makes what it writes whole."""

    def take(self, row: Sequence[float]) -> None:
        """The values of one cycle, in the order of the signals."""

    def close(self) -> None:
        """There are no more."""


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
