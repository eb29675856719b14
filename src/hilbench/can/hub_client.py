"""Client of the embedded bus's hub: find or start it, join its bus, send it requests.

The first client starts the hub: under a lock it binds the socket, connects to it, and hands the listening socket to
the new process. A hub that ends removes the socket under the same lock, so that no client is left between the two.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hilbench.can import protocol
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.requests import Settings, Wanted
from hilbench.errors import BusError

#: How long a request, or the start of a hub, may take (the machine may be busy).
_TIMEOUT_S = 10.0
#: A hub that is just ending can close a connection: then another one is started.
_ATTEMPTS = 5

Filters = Sequence[tuple[int, int]] | None


@dataclass(frozen=True)
class Membership:
    """A station's connection (non-blocking socket), its number on this bus and how the bus runs."""

    connection: socket.socket
    station: int
    settings: Settings


@dataclass(frozen=True)
class BusStatistics:
    """Counters of an embedded bus since its first station joined; `time_ns` is bus time since then."""

    bitrate: int  #: bit/s
    data_bitrate: int  #: bit/s, FD frames with bit rate switch
    timing: str
    stations: int
    frames: int
    bits: int  #: bit times the wire was taken: frames with stuff bits and intermission, error frames
    error_frames: int
    lost: int  #: frames that error injection took away
    dropped: int  #: frames that present receivers did not read in time
    malformed: int  #: records that were no frames
    time_ns: int

    @property
    def load(self) -> float:
        """Fraction of the bus time in which the wire was taken."""
        return self.bits * 1e9 / (self.bitrate * self.time_ns) if self.time_ns else 0.0


def join(
    channel: str,
    wanted: Wanted,
    *,
    filters: Filters = None,
    receive_own: bool = False,
    fd: bool = False,
    single: bool = False,
) -> Membership:
    """Become a station of the embedded bus `channel`; starts its hub if none runs.

    Raises BusError when the bus runs with other settings, or no hub can be started.
    """
    content = {
        "request": "join",
        **asdict(wanted),
        "filters": _as_json(filters),
        "receive_own": receive_own,
        "fd": fd,
        "single": single,
    }
    for _ in range(_ATTEMPTS):
        connection = _connect_or_start(channel)
        try:
            reply = _ask(connection, channel, content)
        except BaseException:
            connection.close()
            raise
        if reply is not None:
            connection.setblocking(False)
            settings = Settings(reply["bitrate"], reply["data_bitrate"], reply["timing"])
            return Membership(connection, reply["station"], settings)
        connection.close()
    raise hub_lost(channel)


def set_filters(channel: str, station: int, filters: Filters) -> None:
    """Let frames pass that one (identifier, mask) accepts; in effect for every frame that ends after the return."""
    _request(channel, {"request": "set_filters", "station": station, "filters": _as_json(filters)})


def inject_errors(channel: str, injection: ErrorInjection) -> None:
    """Disturb the frames sent from now on, until the last station leaves. Raises BusError if the bus has no station."""
    _request(channel, {"request": "set_errors", **asdict(injection)})


def set_priority(channel: str, priority: int) -> None:
    """Set the hub's priority (SCHED_FIFO, 1 to 99) for as long as it runs: stations with a priority
    wait for it. Raises BusError where that is not permitted, or the bus has no station."""
    _request(channel, {"request": "set_priority", "priority": priority})


def statistics(channel: str) -> BusStatistics:
    """Counters of the embedded bus `channel`. Raises BusError if no program has it open."""
    return BusStatistics(**_request(channel, {"request": "statistics"}))


def running_channels() -> list[str]:
    """Channels of the embedded bus that this user's programs have open, in this runtime directory."""
    return [name for name in sorted(path.stem for path in protocol.directory().glob("*.sock")) if runs(name)]


def runs(channel: str) -> bool:
    """True if a hub serves `channel`."""
    connection = _connect(protocol.socket_path(channel))
    if connection is None:
        return False
    connection.close()
    return True


def hub_lost(channel: str) -> BusError:
    """The error for a connection that the hub has closed."""
    log = protocol.socket_path(channel).with_suffix(".log")
    if log.exists() and log.stat().st_size:
        return BusError(f"embedded bus {channel}: its hub failed: {_last_line(log)} (all of it: {log})")
    return BusError(f"embedded bus {channel}: its hub has ended")


def _nobody(channel: str) -> BusError:
    return BusError(f"embedded bus {channel}: no program has it open")


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else "no output"


def _as_json(filters: Filters) -> list[list[int]] | None:
    return None if filters is None else [[identifier, mask] for identifier, mask in filters]


def _request(channel: str, content: dict[str, Any]) -> dict[str, Any]:
    """Send a request over a connection of its own, so that frames for a station never delay its answer."""
    connection = _connect(protocol.socket_path(channel))
    if connection is None:
        raise _nobody(channel)
    with connection:
        reply = _ask(connection, channel, content)
    if reply is None:
        raise hub_lost(channel)
    return reply


def _ask(connection: socket.socket, channel: str, content: dict[str, Any]) -> dict[str, Any] | None:
    """The hub's reply; None: the hub has closed the connection."""
    try:
        connection.send(json.dumps(content).encode())
        packet = connection.recv(protocol.PACKET_BYTES)
    except TimeoutError:
        raise BusError(f"embedded bus {channel}: its hub did not answer within {_TIMEOUT_S:g} s") from None
    except (ConnectionError, BrokenPipeError):
        return None
    if not packet:
        return None
    reply: dict[str, Any] = json.loads(packet)
    if "error" in reply:
        raise BusError(f"embedded bus {channel}: {reply['error']}")
    return reply


def _connect(path: Path) -> socket.socket | None:
    """A connection to the hub listening at `path`; None: none does."""
    try:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except OSError as error:
        raise BusError(f"{path}: no socket to be had ({error.strerror})") from error
    connection.settimeout(_TIMEOUT_S)
    try:
        connection.connect(os.fspath(path))
    except (FileNotFoundError, ConnectionRefusedError):
        connection.close()
        return None
    except OSError as error:
        connection.close()
        raise BusError(f"{path}: {error.strerror or error}, expected the embedded bus' socket") from None
    if not protocol.may_trust(connection):
        connection.close()
        raise BusError(f"{path}: another user's process listens there")
    return connection


def _connect_or_start(channel: str) -> socket.socket:
    path = protocol.socket_path(channel)
    connection = _connect(path)
    if connection is not None:
        return connection
    if protocol.is_path(channel):
        raise _nobody(channel)
    try:
        with _lock(path.parent):
            return _connect(path) or _start_hub(channel, path)
    except OSError as error:
        where = error.filename or path
        raise BusError(f"embedded bus {channel}: its hub cannot be started ({error.strerror}): {where}") from error


@contextlib.contextmanager
def _lock(folder: Path) -> Iterator[None]:
    descriptor = os.open(protocol.lock_path(folder), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # explicitly: a forked child may still hold the descriptor
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def starting(channel: str) -> Iterator[None]:
    """Start the hub of `channel` meanwhile, where there is none: a client that joins waits less, and gets the error
    of a failed start."""
    path = protocol.socket_path(channel)
    with contextlib.ExitStack() as resources:
        if not protocol.is_path(channel):
            with contextlib.suppress(OSError, BusError), _lock(path.parent):
                connection = _connect(path)
                if connection is None:
                    connection, starter = _begin_hub(channel, path)
                    resources.callback(_ended, starter)
                resources.enter_context(connection)
        yield


def _start_hub(channel: str, path: Path) -> socket.socket:
    """The connection to a hub that has detached itself."""
    connection, starter = _begin_hub(channel, path)
    try:
        _check_started(channel, path.parent, starter)
    except BaseException:
        connection.close()
        path.unlink(missing_ok=True)
        raise
    return connection


def _begin_hub(channel: str, path: Path) -> tuple[socket.socket, subprocess.Popen[bytes]]:
    """Listen at `path` (a dead hub's socket file gives way), connect, and start the hub with the listening socket."""
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(os.fspath(path))
        path.chmod(0o600)
        listener.listen(64)
        connection = _connect(path)
        assert connection is not None
        try:
            starter = _spawn(channel, path.parent, listener)
        except BaseException:
            connection.close()
            path.unlink(missing_ok=True)
            raise
    return connection, starter


def _spawn(channel: str, folder: Path, listener: socket.socket) -> subprocess.Popen[bytes]:
    """Start the hub process; it ends when the hub has detached itself."""
    log = protocol.log_path(folder, channel)
    # The hub needs the standard library and this package: no site-packages (-S), nothing from a current directory (-P).
    command = [sys.executable, "-S", "-P", "-m", "hilbench.can.hub"]
    options = ["--channel", channel, "--directory", os.fspath(folder), "--listener", str(listener.fileno())]
    environment = {**os.environ, "PYTHONPATH": os.fspath(Path(__file__).resolve().parents[2])}
    with log.open("wb") as output:
        return subprocess.Popen(
            command + options,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=output,
            pass_fds=[listener.fileno()],
            start_new_session=True,
        )


def _check_started(channel: str, folder: Path, starter: subprocess.Popen[bytes]) -> None:
    if not _ended(starter):
        starter.kill()
        starter.wait()
        raise BusError(f"embedded bus {channel}: its hub did not start within {_TIMEOUT_S:g} s")
    if starter.returncode:
        raise BusError(
            f"embedded bus {channel}: its hub did not start: {_last_line(protocol.log_path(folder, channel))}"
        )


def _ended(process: subprocess.Popen[bytes]) -> bool:
    """True if it ends within the time for a hub's start; `wait` with a time-out would poll only now and then."""
    end, poll = os.pidfd_open(process.pid), select.poll()
    poll.register(end, select.POLLIN)
    try:
        if not poll.poll(1e3 * _TIMEOUT_S):
            return False
    finally:
        os.close(end)
    process.wait()
    return True
