"""Samples of a bench that runs, cycle by cycle, from the frames on its bus.

Frames become samples by what recovers a run from its trace (`hilbench.results.recover.Decoder`). What no frame shows,
set-points and what is emulated, is in the journal of the run, where its folder is on this machine; else it is unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Final

import numpy as np

from hilbench.apps.library.live_run import LiveRun
from hilbench.apps.monitor.picture import START_ALL
from hilbench.apps.pages.live.history import History
from hilbench.apps.pages.live.machines.kinds import settled
from hilbench.arrays import Array
from hilbench.bench.reports.change import Change
from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import NMT, SYNC
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.results.recover import CycleFrames, CycleSplitter, Decoder, take_units
from hilbench.runs.events import EventLog
from hilbench.topology.config import BenchConfig
from hilbench.topology.signal_kinds import TIME

#: Of what comes before the first SYNC, the drives' answers say their units.
_MOST_WAITING: Final = 50_000
#: Entries of a journal that are sent one by one.
REPORTED: Final = frozenset(
    {"enabled", "stopping", "loop_open", "loop_closed", "predicted", "gap_seen", "model_proposed", "asked"}
)


#: The run on the bus of a name, if it is known.
FindRun = Callable[[str], LiveRun | None]


class LiveSamples:
    """Puts the samples of one bench into a history.

    `find_run` has the run on a bus, where its folder is here; `channel`: the bus as a trace names it.
    """

    def __init__(self, config: BenchConfig, history: History, find_run: FindRun, channel: str) -> None:
        self._config = config
        self._history = history
        self._find_run, self._channel = find_run, channel
        self._names = [signal.name for signal in config.signals]
        self._time = self._names.index(TIME)
        self._shown = [self._names.index(name) for name in history.names]
        truths = {signal.name for signal in config.signals if signal.group == "truth"}
        self._truth = [at for at, name in enumerate(history.names) if name in truths]
        self._rows: list[Sequence[float]] = []
        self._begin(from_start=False)
        Decoder(config, self._nodes, None, self._rows.append)  # compiles, or loads, what each cycle runs

    def _begin(self, *, from_start: bool) -> None:
        self.run: LiveRun | None = None  #: the folder of the run that is received
        self.log = EventLog(self._config.cycle_time_s)  #: what its journal says
        self.problem = ""  #: why there are no samples any more
        self._changes: list[Change] = []
        self._to_report: list[Change] = []
        self._reported: list[Change] = []
        self._first_cycle = 0
        self._nodes = Nodes(self._config)
        self._splitter = CycleSplitter(self._nodes)
        self._decoder: Decoder | None = None
        self._cycle = 0
        self._simulates_anew = False
        self._from_start = from_start
        self._first_row: Array | None = None  # of a run that was joined late, until the emulation is right

    @property
    def cycle(self) -> int:
        """Number of the last cycle, as the journal counts them; 0 where that is not known."""
        return self._cycle if self.run is not None else 0

    def reported(self) -> list[tuple[float, Change]]:
        """Journal changes other than set quantities and what `log` has, since the last call: time, s, and change."""
        due, self._reported = self._reported, []
        return [((change.cycle - self._first_cycle) * self._config.cycle_time_s, change) for change in due]

    def take(self, frames: Iterable[Frame]) -> None:
        """Take further frames, in the order of reception."""
        self._read_journal()
        for frame in frames:
            if frame.can_id == NMT and frame.data == START_ALL:
                self._start_anew()
            elif frame.can_id == SYNC and self._decoder is None:
                self._join(frame)
            cycle = self._splitter.take(frame)
            if cycle is not None:
                self._decode(cycle)
        waiting = self._splitter.current.received
        if len(waiting) > _MOST_WAITING:
            del waiting[:-_MOST_WAITING]
        self._store()

    def _start_anew(self) -> None:
        """Begin a run when a bench starts its nodes: its configuration was received before."""
        configuration = self._splitter.current.received
        self._store()
        self._begin(from_start=True)
        self._splitter.current.received = configuration

    def _join(self, sync: Frame) -> None:
        """Join a run at the first SYNC received."""
        self._history.clear()
        self.run = self._find_run(self._channel)
        take_units(self._nodes, self._splitter.current.received)
        changes, begun = None if self.run is None else self._changes, not self._from_start
        if begun and self.run is not None:
            self._cycle = self.run.cycles(sync.time_ns, self._config.cycle_ns)
        self._read_journal()
        keep = self._rows.append
        self._decoder = Decoder(self._config, self._nodes, changes, keep, begun=begun, cycles=self._cycle)
        self._simulates_anew = begun and any(change.what == "enabled" for change in self._changes)

    def _decode(self, cycle: CycleFrames) -> None:
        if cycle.sync is None or self._decoder is None or self.problem:
            return
        self._cycle += 1
        try:
            self._decoder.take(cycle)
        except BenchFaultError as error:
            self.problem = str(error)

    def _read_journal(self) -> None:
        if self.run is None:
            return
        try:
            new = self.run.journal.new()
        except UnusableInputError as error:
            self.problem = str(error)
            return
        self._changes += [change for change in new if change.what != "asked"]
        self._to_report += new
        self._report(math.inf if not self.run.is_played else self._cycle)

    def _report(self, until: float) -> None:
        """Report the journal's changes until a cycle: in a replay the journal has later ones already."""
        while self._to_report and self._to_report[0].cycle <= until:
            change = self._to_report.pop(0)
            self.log.add(change)
            if change.what == "enabled":
                self._first_cycle = change.cycle
            if change.what in REPORTED:
                self._reported.append(change)

    def _store(self) -> None:
        if not self._rows:
            return
        rows = np.array(self._rows, np.float64)
        self._rows.clear()
        shown = rows[:, self._shown]
        if self._simulates_anew:
            self._first_row = rows[0] if self._first_row is None else self._first_row
            self._simulates_anew = not settled(self._config, self._names, self._first_row, rows[-1])
            shown[:, self._truth] = np.nan
        self._history.add(rows[:, self._time], shown)
