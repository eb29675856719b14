"""Claims on a bus of this machine: its one master, and the programs that provide its simulated nodes.

A claim is a listening socket in the kernel's abstract namespace (unix(7)), named after the bus and the role. Such a
name can be bound once at a time, is free again as soon as the process has ended, in whatever way, and depends on no
folder, environment, session or service. It reaches as far as CAN interfaces do: the network namespace. The kernel
identifies the process; its purpose is sent by the process to each that connects.
"""

from __future__ import annotations

import errno
import hashlib
import json
import pwd
import selectors
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from hilbench.can.protocol import peer
from hilbench.errors import BusError, UnusableInputError

MASTER = "master"

_PREFIX = "hilbench:"
_NAME_BYTES = 107  # of sun_path, after the zero that makes a name abstract
_SHORTENED = "sha256="  # in the place of a bus whose own name is longer
_SOCKETS = Path("/proc/net/unix")
_LISTENING = 0x10000  # __SO_ACCEPTCON in the flags there
_ANSWER_S = 0.5
_ANSWER_BYTES = 4096
_LONGEST_TEXT = 300
_HIGHEST_BITRATE = 1_000_000
_AGAIN_S = 0.05
_BACKLOG = 1024  # who connects to a process that was stopped (SIGSTOP) waits there
#: The thread only waits: with locked memory a stack of the usual 8 MiB would be locked, too.
_STACK_BYTES = 256 * 1024


def player_of(node_id: int) -> str:
    """The role of the process that plays a node."""
    return f"node{node_id}"


def bringer_of(node_id: int) -> str:
    """Role of the program that brings a node to the bus: it runs it, or starts the process that does."""
    return f"bring{node_id}"


@dataclass(frozen=True)
class Holder:
    """Holder of a role on a bus. `pid` and `uid` are from the kernel, the rest from the process itself."""

    place: str  #: the bus, as `hilbench.can.open.BusAddress.place` has it; "" when it could not be read
    role: str
    pid: int
    uid: int
    what: str = ""  #: "bench web_section_step"
    command: str = ""  #: "hilbench run web_section_step.yaml"
    folder: str = ""  #: in which it was started
    since_s: float | None = None  #: of the wall clock
    bitrate: int | None = None  #: bit/s, of its bus

    @property
    def user(self) -> str:
        """Name of the user, or the number of one that has none."""
        try:
            return pwd.getpwuid(self.uid).pw_name
        except KeyError:
            return str(self.uid)

    def __str__(self) -> str:
        doing = ": ".join(text for text in (self.what, f"'{self.command}'" if self.command else "") if text)
        if not self.pid:
            return "a program that does not answer"
        since = "" if self.since_s is None else f", since {_clock(self.since_s)}"
        folder = f" in {self.folder}" if self.folder else ""
        return f"{doing or 'a program'}{folder} (process {self.pid} of {self.user}{since})"


class TakenError(UnusableInputError):
    """The role is held by another process."""

    def __init__(self, bus: str, holder: Holder | None, expected: str) -> None:
        found = "a program that ends or does not say who it is" if holder is None else str(holder)
        super().__init__(bus, f"taken by {found}, expected {expected}")


@contextmanager
def claim(
    place: str,
    roles: Mapping[str, str],
    what: str,
    *,
    bus: str = "",
    bitrate: int | None = None,
    patience_s: float = 0.0,
) -> Iterator[None]:
    """Hold roles on a bus, all or none; the value of each is the text on what was expected, if it is taken.

    Raises TakenError, at `bus` (its readable name), when another process still holds one of them after `patience_s`.
    """
    with ExitStack() as opened:
        sockets = {
            role: opened.enter_context(_bind(place, role, expected, bus or place, patience_s))
            for role, expected in roles.items()
        }
        with _answered({sockets[role]: _own_words(place, role, what, bitrate) for role in sockets}):
            yield


def holder(place: str, role: str) -> Holder | None:
    """Present holder of a role; None: it is free."""
    return _ask(_name(place, role), _ANSWER_S)


def holders(answer_s: float = _ANSWER_S) -> list[Holder]:
    """All holders of a role on any bus of this machine; one that does not answer in time is known by its process only.

    Raises BusError where the kernel does not list its sockets: no holder can be found then.
    """
    asked = (_ask(name, answer_s) for name in _listening())
    return [known for known in asked if known is not None]


def _listening() -> list[str]:
    """Names of the claims that the kernel knows."""
    try:
        lines = _SOCKETS.read_text(encoding="utf-8", errors="surrogateescape").splitlines()[1:]
    except OSError as error:
        raise BusError(f"{_SOCKETS}: {error.strerror}, expected the kernel's list of sockets") from None
    columns = [line.split(None, 7) for line in lines]
    listening = (row[7] for row in columns if len(row) == 8 and int(row[3], 16) & _LISTENING)
    # An abstract name is shown with "@" for the zero that it begins with.
    return sorted(name[1:] for name in listening if name.startswith(f"@{_PREFIX}"))


def _name(place: str, role: str) -> str:
    name = f"{_PREFIX}{place}#{role}"
    if len(name.encode(errors="surrogateescape")) <= _NAME_BYTES:
        return name
    digest = hashlib.sha256(place.encode(errors="surrogateescape")).hexdigest()[:16]
    return f"{_PREFIX}{_SHORTENED}{digest}#{role}"


def _address(name: str) -> bytes:
    return b"\0" + name.encode(errors="surrogateescape")


def _bind(place: str, role: str, expected: str, bus: str, patience_s: float) -> socket.socket:
    began_s = time.monotonic()
    while True:
        try:
            claimed = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        except OSError as error:
            raise BusError(f"{bus}: its {role} can't be claimed: {error.strerror}") from error
        try:
            claimed.bind(_address(_name(place, role)))
            claimed.listen(_BACKLOG)
            return claimed
        except OSError as error:
            claimed.close()
            if error.errno != errno.EADDRINUSE:
                raise BusError(f"{bus}: its {role} can't be claimed: {error.strerror}") from None
            known = holder(place, role)
            # No holder though it is taken: it has just been bound, or is just being released.
            if time.monotonic() - began_s >= max(patience_s, 0.0 if known else _ANSWER_S):
                raise TakenError(bus, known, expected) from None
        time.sleep(_AGAIN_S)


def _own_words(place: str, role: str, what: str, bitrate: int | None) -> bytes:
    program = Path(sys.argv[0]).name if sys.argv and sys.argv[0] else "python"
    command = " ".join(["hilbench" if program == "__main__.py" else program, *sys.argv[1:]])
    answers = {
        "place": place,
        "role": role,
        "what": what,
        "command": command[:_LONGEST_TEXT],
        "folder": _here()[:_LONGEST_TEXT],
        "since_s": time.time(),
        "bitrate": bitrate,
    }
    return json.dumps(answers).encode()


def _here() -> str:
    try:
        return str(Path.cwd())
    except OSError:  # it was removed
        return ""


@contextmanager
def _answered(answers: Mapping[socket.socket, bytes]) -> Iterator[None]:
    """Answer each connection meanwhile, by a thread that does nothing else."""
    if not answers:  # no connection is possible, nor a wake-up of the thread at the end
        yield
        return

    def serve() -> None:
        with selectors.DefaultSelector() as waiting:
            for claimed in answers:
                waiting.register(claimed, selectors.EVENT_READ, claimed)
            while True:
                for key, _ in waiting.select():
                    try:
                        connection, _address = key.data.accept()
                    except OSError:  # the end: it was shut down
                        return
                    with connection, suppress(OSError):  # the peer has left
                        connection.send(answers[key.data], socket.MSG_DONTWAIT)

    thread = threading.Thread(target=serve, name="claim", daemon=True)
    before = threading.stack_size(_STACK_BYTES)
    try:
        thread.start()
    finally:
        threading.stack_size(before)
    try:
        yield
    finally:
        for claimed in answers:
            with suppress(OSError):
                claimed.shutdown(socket.SHUT_RDWR)
        thread.join()


def _ask(name: str, answer_s: float) -> Holder | None:
    place, _, role = name.removeprefix(_PREFIX).rpartition("#")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection:
        connection.settimeout(answer_s)
        try:
            connection.connect(_address(name))
        except ConnectionRefusedError:  # free, or just being bound or released
            return None
        except OSError:  # its backlog is full
            return Holder(place, role, pid=0, uid=-1)
        pid, uid = peer(connection)
        try:
            answers = json.loads(connection.recv(_ANSWER_BYTES))
        except (OSError, ValueError):  # it was stopped (SIGSTOP), or is ending
            answers = {}
    if not isinstance(answers, dict):
        answers = {}
    if place.startswith(_SHORTENED):  # then the process states it, and it must be the one that is claimed
        place = stated_place if _name(stated_place := _text(answers, "place"), role) == name else ""
    since_s, bitrate = answers.get("since_s"), answers.get("bitrate")
    return Holder(
        place=place,
        role=role,
        pid=pid,
        uid=uid,
        what=_text(answers, "what"),
        command=_text(answers, "command") or command_line(pid),
        folder=_text(answers, "folder"),
        since_s=since_s if isinstance(since_s, float) and 0.0 < since_s < 1e11 else None,
        bitrate=bitrate if isinstance(bitrate, int) and 0 < bitrate <= _HIGHEST_BITRATE else None,
    )


def _text(answers: dict[str, Any], key: str) -> str:
    value = answers.get(key)
    return _one_line(value) if isinstance(value, str) else ""


def command_line(pid: int) -> str:
    """Command line of a process; "" where it is not known."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return ""
    return _one_line(b" ".join(words).decode(errors="replace").strip())


def _one_line(text: str) -> str:
    """Another program's words: they must not move a terminal's cursor."""
    return "".join(char if char.isprintable() else "?" for char in text[:_LONGEST_TEXT])


def _clock(time_s: float) -> str:
    then = datetime.fromtimestamp(time_s)
    return f"{then:%H:%M:%S}" if then.date() == datetime.now().date() else f"{then:%Y-%m-%d %H:%M:%S}"
