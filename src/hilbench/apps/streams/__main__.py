"""``python -m hilbench.apps.streams SOCKET``: takes the samples of a bench from an open socket, as that starts it."""

from __future__ import annotations

import os
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import closing
from multiprocessing.connection import Connection

from hilbench.apps.streams.sinks import Sink, open_sink, rows_of
from hilbench.errors import UnusableInputError
from hilbench.exit_status import ended
from hilbench.real_time import give_way
from hilbench.topology.signal_kinds import Signal

_PIECE = 1 << 18


def main() -> None:
    """Send samples to the target until the bench closes its end, or disconnects."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(5)
    with socket.socket(fileno=int(sys.argv[1])) as bench, Connection(os.dup(bench.fileno())) as connection:
        try:
            target, signals, name, began_s, leave = connection.recv()
        except EOFError:  # the bench has ended
            return
        if leave is not None:
            give_way(leave)
        try:
            sink = open_sink(target, signals, name, began_s)
        except UnusableInputError as error:
            connection.send((error.place, error.problem))
            return
        connection.send(None)
        take(bench, sink, signals)


def take(bench: socket.socket, sink: Sink, signals: Sequence[Signal]) -> None:
    """Hand every sample to the sink, until there are no more."""
    size, rest = 8 * len(signals), b""
    with closing(sink):
        while piece := bench.recv(_PIECE):
            data = rest + piece
            whole = len(data) - len(data) % size
            for row in rows_of(data[:whole], len(signals)):
                sink.take(row)
            rest = data[whole:]


if __name__ == "__main__":
    sys.exit(ended(main))
