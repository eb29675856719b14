"""Journal entries of an operator's actions at a monitor, in the run that they act on."""

from __future__ import annotations

import time
from pathlib import Path

from hilbench.apps.library.labels import user_name
from hilbench.apps.library.live_run import LiveRun
from hilbench.bench.reports.change import Change
from hilbench.results.journal import append_to_journal


def somebody_here() -> str:
    """Name of the user at this terminal, as written in a journal."""
    return f"{user_name('somebody')} (terminal)"


class OperatorJournal:
    """Notes them in the run on a bus, where its folder is among `runs` on this machine; `channel` is the bus' name in a
    trace, `cycle_ns` the bench's cycle."""

    def __init__(self, runs: Path, channel: str, cycle_ns: int) -> None:
        self._runs, self._channel, self._cycle_ns = runs, channel, cycle_ns
        self._run: LiveRun | None = None
        self.who = somebody_here()

    def note(self, text: str, value: float = 0.0) -> None:
        """Somebody has done this now; without a run that is known it is nowhere noted.

        Raises UnusableInputError for a journal that can't be written.
        """
        if (run := self._of_now()) is not None:
            cycle = run.cycles(time.time_ns(), self._cycle_ns)
            append_to_journal(run.folder.journal, Change(cycle, "asked", text, value, who=self.who))

    def _of_now(self) -> LiveRun | None:
        if self._run is None or not self._run.continues:
            self._run = LiveRun.on(self._runs, self._channel)
        return self._run
