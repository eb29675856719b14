"""Progress of a long command: a bar on a terminal, a line for each new thing elsewhere (in the log of a CI)."""

from __future__ import annotations

import time
from collections.abc import Callable

from rich.console import Console

from hilbench.bench.tasks.task import MANY, CompiledStages
from hilbench.topology.sample import CycleSample

#: Experiment time between two lines of a run where there is no terminal, and wall time between two words on one.
_LINE_EVERY_S, _WORD_EVERY_S = 5.0, 0.2


class RunObserver:
    """Cycle observer that shows a sample when it is time to: by the wall clock on a terminal, by experiment time
    elsewhere."""

    def __init__(self, show: Callable[[CycleSample], None], cycle_s: float, *, on_terminal: bool) -> None:
        self._show, self._cycle_s, self._on_terminal = show, cycle_s, on_terminal
        self._next_s = 0.0

    def sample(self, sample: CycleSample) -> None:
        """One cycle."""
        now_s = time.monotonic() if self._on_terminal else sample.t_s
        if now_s >= self._next_s:
            self._next_s = now_s + (_WORD_EVERY_S if self._on_terminal else _LINE_EVERY_S)
            self._show(sample)

    def compiled_stages(self, sample: CycleSample) -> CompiledStages:
        """Nothing is shown of cycles before it is time to."""

        def cycles() -> int:
            if self._on_terminal:
                return MANY if time.monotonic() < self._next_s else 0
            return max(0, int((self._next_s - sample.t_s) / self._cycle_s) - 1)

        return CompiledStages(cycles=cycles)


class ProgressDisplay:
    """A context manager; nothing is shown when `quiet`."""

    def __init__(self, console: Console, *, quiet: bool) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn  # a run has a table instead

        self.on_terminal = console.is_terminal
        self._console = console
        self._quiet = quiet
        self._started_s = time.monotonic()
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TimeElapsedColumn(),
            console=console,
            disable=quiet or not self.on_terminal,
            transient=True,
        )
        self._task = self._bar.add_task("", total=1.0)

    def __enter__(self) -> ProgressDisplay:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def announce(self, text: str, share: float) -> None:
        """Say what is done now, and which share of the whole is done (0 to 1)."""
        if self.on_terminal:
            self._bar.update(self._task, description=text, completed=share)
        elif not self._quiet:
            self._console.print(f"{time.monotonic() - self._started_s:6.1f} s  {text}", soft_wrap=True)

    def of_run(self, what: str, share: float, cycle_s: float) -> tuple[RunObserver, Callable[[str], None]]:
        """Observer of a run of the bench, and receiver of its announcements."""
        self.announce(what, share)
        observer = RunObserver(
            lambda sample: self.announce(f"{what}: t = {sample.t_s:.1f} s", share),
            cycle_s,
            on_terminal=self.on_terminal,
        )
        return observer, lambda text: self.announce(f"{what}: {text}", share)
