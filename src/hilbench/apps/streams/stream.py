"""A stream as the bench sees it: an observer that packs each cycle and hands it to a process of its own, never waiting.

What that process has not taken yet waits in a socket's buffer, which is bounded; what does not fit is dropped and
counted. Only a file beside a bench in lockstep, whose time is no clock's, is waited for, so that it has every cycle.
"""

from __future__ import annotations

import os
import socket
import struct
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.connection import Connection
from operator import attrgetter
from pathlib import Path
from typing import Final

from hilbench.apps.streams.sinks import Target
from hilbench.errors import UnusableInputError
from hilbench.processes import ChildProcess
from hilbench.results.result import StreamRecord
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample

_MODULE: Final = "hilbench.apps.streams"
#: What may wait in the buffer, bytes, as far as the system allows: about a second.
_BUFFER: Final = 1 << 20
#: Bus time in a piece that is handed over: who looks on sees it that late.
_PIECE_S: Final = 0.02
#: Cycles in a piece for a file.
_FILE_PIECE: Final = 64
#: Longest that a bench in lockstep waits for a file, and that the end of a stream is waited for, s.
_PATIENCE_S: Final = 10.0
_LONGEST_START_S: Final = 60.0


class Stream:
    """One target's process, and what was handed to it. Raises UnusableInputError for a target that can't be opened."""

    def __init__(self, target: Target, config: BenchConfig, folder: Path) -> None:
        self.target = target
        self.samples = 0  #: cycles that were handed over or dropped
        self.dropped = 0
        names = [signal.name for signal in config.signals]
        self._values = attrgetter(*names)
        self._row = struct.Struct(f"{len(names)}d")
        self._most = _FILE_PIECE if target.may_wait else max(round(_PIECE_S / config.cycle_time_s), 1)
        self._piece = bytearray(self._most * self._row.size)
        self._filled = 0
        self._rest: memoryview | None = None  #: of a piece of which only a part went
        self._ended = ""
        ours, theirs = socket.socketpair()
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER)
        self._socket = ours
        with theirs:
            number = theirs.fileno()
            self._child = ChildProcess(
                f"stream to {target}", [_MODULE, str(number)], folder / "stream.log", pass_fds=(number,)
            )
        self._open(config)
        self._waits = target.may_wait and config.pace == "lockstep"
        ours.settimeout(_PATIENCE_S if self._waits else 0.0)

    def _open(self, config: BenchConfig) -> None:
        cores = config.realtime.cores
        away = [core for core in (cores.bench, cores.hardware, cores.twin) if core is not None]
        leave = set(away) if config.pace == "realtime" else None
        problem: tuple[str, str] | None = str(self.target), "ended"
        with suppress(OSError, EOFError), Connection(os.dup(self._socket.fileno())) as connection:
            connection.send((self.target, config.signals, config.name, time.time(), leave))
            if connection.poll(_LONGEST_START_S):
                problem = connection.recv()
        if problem is not None:
            self._end()
            raise UnusableInputError(*problem)

    @property
    def pid(self) -> int:
        """Process id of its process."""
        return self._child.pid

    def sample(self, sample: CycleSample) -> None:
        """Pack one cycle; hand a piece over when it is full."""
        self._row.pack_into(self._piece, self._filled * self._row.size, *self._values(sample))
        self._filled += 1
        if self._filled == self._most:
            self._hand_over()

    def _hand_over(self) -> None:
        piece, count = memoryview(self._piece)[: self._filled * self._row.size], self._filled
        self._filled = 0
        self.samples += count
        try:
            if self._waits:
                self._socket.sendall(piece)
            elif self._rest_is_gone():
                sent = self._socket.send(piece)
                self._rest = memoryview(bytes(piece[sent:])) if sent < len(piece) else None
            else:
                self.dropped += count
        except BlockingIOError:
            self.dropped += count
        except OSError as error:  # its process has ended, or a file takes no more: the run goes on without it
            self.dropped += count
            self._ended = self._ended or str(error)

    def _rest_is_gone(self) -> bool:
        """True if the piece before has been sent whole; else more of it is sent. A piece never goes in part."""
        if self._rest is None:
            return True
        sent = self._socket.send(self._rest)
        self._rest = self._rest[sent:] if sent < len(self._rest) else None
        return self._rest is None

    def close(self) -> None:
        """Hand over what is left, and wait until the process has written all."""
        self._socket.settimeout(_PATIENCE_S)
        self._waits = True
        try:
            if self._rest is not None:
                self._socket.sendall(self._rest)
        except OSError as error:
            self._ended = self._ended or str(error)
        if self._filled:
            self._hand_over()
        self._end()

    def _end(self) -> None:
        self._socket.close()
        until_s = time.monotonic() + _PATIENCE_S
        while not self._child.ended and time.monotonic() < until_s:
            time.sleep(0.01)
        self._child.end()

    def record(self) -> StreamRecord:
        """Record of the stream for the result."""
        return StreamRecord(to=str(self.target), samples=self.samples + self._filled, dropped=self.dropped)


@contextmanager
def streams_to(targets: Sequence[Target], config: BenchConfig) -> Iterator[list[Stream]]:
    """Streams of a bench that is about to run; closed whatever happens. Raises UnusableInputError."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hilbench-streams-")))
        opened = []
        for number, target in enumerate(targets):
            (folder / str(number)).mkdir()
            stream = Stream(target, config, folder / str(number))
            stack.callback(stream.close)
            opened.append(stream)
        yield opened
