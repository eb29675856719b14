"""``python -m hilbench.apps.streams SOCKET``: takes the samples of a bench from an open socket, as that starts it."""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hilbench.apps.streams.sinks import Sink, Target, open_sink, rows_of
from hilbench.errors import UnusableInputError
from hilbench.exit_status import ended
from hilbench.real_time import give_way
from hilbench.topology.signal_kinds import Signal

_PIECE = 1 << 18


def main() -> None:
    """Send samples to the target until the bench closes its end, or disconnects."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.nice(5)
    with socket.socket(fileno=int(sys.argv[1])) as bench:
        asked, rest = _asked(bench)
        target = Target(**asked["target"] | {"path": Path(asked["target"]["path"])})
        signals = [Signal(*each) for each in asked["signals"]]
        if asked["leave"] is not None:
            give_way(set(asked["leave"]))
        try:
            sink = open_sink(target, signals, asked["bench"], asked["began_s"])
        except UnusableInputError as error:
            bench.sendall(f"{error.place}\0{error.problem}".encode())
            return
        bench.sendall(b"ready")
        take(bench, sink, signals, rest)


def _asked(bench: socket.socket) -> tuple[dict[str, Any], bytes]:
    data = b""
    while b"\n" not in data:
        piece = bench.recv(_PIECE)
        if not piece:
            sys.exit(0)
        data += piece
    line, _, rest = data.partition(b"\n")
    return json.loads(line), rest


def take(bench: socket.socket, sink: Sink, signals: Sequence[Signal], rest: bytes = b"") -> None:
    """Hand every sample to the sink, until there are no more."""
    size = 8 * len(signals)
    try:
        while piece := bench.recv(_PIECE):
            data = rest + piece
            whole = len(data) - len(data) % size
            for row in rows_of(data[:whole], len(signals)):
                sink.take(row)
            rest = data[whole:]
    finally:
        sink.close()


if __name__ == "__main__":
    sys.exit(ended(main))
