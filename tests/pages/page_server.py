"""The server of the pages, as a user starts it."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from tests.bench.whole_runs import STARTED


class Server:
    """The page's server of a config, as a process."""

    def __init__(self, path: Path, *more: str) -> None:
        options = ["--browser", "--port", "0", "--runs", str(path.parent / "runs"), *more]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hilbench", "monitor", str(path), *options],
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        STARTED.append(self.process)
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().removeprefix("page: ").strip()

    def end(self) -> None:
        self.process.send_signal(signal.SIGINT)
        assert self.process.wait(30) == 0
