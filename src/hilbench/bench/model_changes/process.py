"""The live diagnosis's process as the bench sees it: requests out, answers in, without waiting."""

from __future__ import annotations

import socket
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from pathlib import Path

from hilbench.bench.reports.diagnosis_updates import DiagnosisAnswer, ProposalOutcome, Ready, Samples
from hilbench.errors import BenchFaultError
from hilbench.processes import ChildProcess
from hilbench.real_time import beside_the_cycle
from hilbench.topology.config import BenchConfig
from hilbench.topology.resolved import write_resolved

#: Name of the process, in messages and of its log.
LIVE_DIAGNOSIS = "live diagnosis"
_MODULE = "hilbench.live"
#: Its matrices are many and small: threads of one product wait for each other, and take cores from the cycle.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
#: Longest time to compile on first use, s.
_LONGEST_START_S = 600.0


class LiveProcess:
    """Live diagnosis process of one run. A thread sends in order; a process that has ended answers nothing.

    It loads and compiles on the cores that the cycle needs: `wait_until_ready` before there is one. Raises
    BenchFaultError when the system refuses to start it.
    """

    def __init__(self, config: BenchConfig, folder: Path) -> None:
        path = folder / "config.yaml"
        write_resolved(config, path)
        ours, theirs = socket.socketpair()
        self._connection = Connection(ours.detach())
        with theirs:
            number = theirs.fileno()
            arguments = [_MODULE, str(path), "--pace", config.pace, "--connection", str(number)]
            log = folder / "live_diagnosis.log"
            self._child = ChildProcess(LIVE_DIAGNOSIS, arguments, log, pass_fds=(number,), environment=_ONE_THREAD)
        self._pool = ThreadPoolExecutor(
            1, "live-diagnosis", initializer=beside_the_cycle, initargs=(config.process_settings("twin"),)
        )

    def wait_until_ready(self) -> None:
        """Wait until it has loaded and compiled its code. Raises BenchFaultError when it ends instead, or is late."""
        try:
            update = self._connection.recv() if self._connection.poll(_LONGEST_START_S) else None
        except (EOFError, OSError):
            self.end()
            raise BenchFaultError(f"{LIVE_DIAGNOSIS} ended by itself: {self.last_words()}") from None
        if not isinstance(update, Ready):
            raise BenchFaultError(f"{LIVE_DIAGNOSIS} is not ready after {_LONGEST_START_S:g} s")

    @property
    def pid(self) -> int:
        """Process id."""
        return self._child.pid

    def ask(self, samples: Samples) -> Future[DiagnosisAnswer]:
        """Send a chunk of samples; the future is its answer, or EOFError or OSError if the process has ended."""
        return self._pool.submit(self._ask, samples)

    def send_outcome(self, outcome: ProposalOutcome) -> None:
        """Report the outcome of a proposed change, before the next samples."""
        self._pool.submit(self._connection.send, outcome)

    def _ask(self, samples: Samples) -> DiagnosisAnswer:
        self._connection.send(samples)
        answer = self._connection.recv()
        assert isinstance(answer, DiagnosisAnswer), "it answers samples with nothing else"
        return answer

    def last_words(self) -> str:
        """Last output of the process, once it has ended."""
        return self._child.last_words()

    def end(self) -> None:
        """End it; requests without an answer are given up."""
        self._child.end()
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._connection.close()
