"""The process that diagnoses beside a running bench, as the bench sees it: questions in, answers out, never waiting."""

from __future__ import annotations

import socket
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

from hilbench.bench.reports.found import Samples, Told, Watched
from hilbench.processes import ChildProcess
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import write_resolved

#: Name of the process, in messages and of its log.
LIVE_DIAGNOSIS = "live diagnosis"
_MODULE = "hilbench.live"


class LiveProcess:
    """One process for one run. What is sent goes out from a thread, in order; a process that is gone answers nothing.

    Raises BenchFaultError when the system refuses to start it.
    """

    def __init__(self, config: BenchConfig, folder: Path) -> None:
        path = folder / "config.yaml"
        write_resolved(config, path)
        ours, theirs = socket.socketpair()
        self._connection = Connection(ours.detach())
        with theirs:
            number = theirs.fileno()
            arguments = [_MODULE, str(path), "--pace", config.pace, "--connection", str(number)]
            self._child = ChildProcess(LIVE_DIAGNOSIS, arguments, folder / "live_diagnosis.log", pass_fds=(number,))
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="live-diagnosis")

    def ask(self, samples: Samples) -> Future[Watched]:
        """Hand a chunk over; the future is its answer, or EOFError or OSError of a process that is gone."""
        return self._pool.submit(self._ask, samples)

    def tell(self, told: Told) -> None:
        """Say what became of a change, before the next samples."""
        self._pool.submit(self._connection.send, told)

    def _ask(self, samples: Samples) -> Watched:
        self._connection.send(samples)
        answer = self._connection.recv()
        assert isinstance(answer, Watched), "it answers samples with nothing else"
        return answer

    def last_words(self) -> str:
        """What it said last, of a process that has ended."""
        return self._child.last_words()

    def end(self) -> None:
        """End it; what it has not answered is given up."""
        self._child.end()
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._connection.close()
