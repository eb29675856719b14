"""Listens to the bus of one bench in a thread of its own, and keeps what a page shows of it.

It receives what the terminal's monitor does, in the same picture (`hilbench.apps.monitor.picture`), and sends nothing.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from math import isfinite
from typing import Any, Final

import numpy as np

from hilbench.apps.library.live_run import LiveRun, continues
from hilbench.apps.monitor.picture import START_ALL, BusPicture, Condition
from hilbench.apps.pages.live.history import Entry, Events, History, Weight
from hilbench.apps.report.chart import VARIABLES
from hilbench.apps.report.panel import Interval, Panel, Series, panels_of
from hilbench.arrays import Array
from hilbench.bench.reports.change import Change
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.emergency_stop import EMERGENCY_STOP, send_emergency_stop
from hilbench.canopen.identifiers import NMT, SYNC
from hilbench.errors import BenchFaultError, BusError, HilbenchError, UnusableInputError
from hilbench.exchange.nodes import Nodes
from hilbench.machine_kinds import machine_part
from hilbench.results.journal import append_to_journal
from hilbench.results.recover import CycleFrames, CycleSplitter, Decoder, take_units
from hilbench.results.result import Result
from hilbench.results.run_folder import RunFolder
from hilbench.runs.events import EventLog
from hilbench.topology.config import BenchConfig
from hilbench.topology.signal_kinds import TIME


def live_panels(config: BenchConfig) -> list[Panel]:
    """Panels of the page of a bench, with those of their series whose signals it has."""
    names = {signal.name for signal in config.signals}
    may_be_unknown = config.shape.has_stations
    found = []
    for panel in panels_of(config.machine.kind, config.shape).panels:
        series = [each for each in panel.series if each.signal in names]
        if not may_be_unknown:
            series = [replace(each, deviation="") for each in series if each.estimated]
        bands = [each for each in panel.bands if names.issuperset(filter(None, (each.signal, each.deviation)))]
        if panel.live and series and names.issuperset(panel.needs):
            found.append(replace(panel, series=series, bands=bands))
    return found


def signals_of(panels: Sequence[Panel]) -> list[str]:
    """Signals that panels show, each once."""
    shown = [(each.signal, each.deviation) for panel in panels for each in panel.series]
    shown += [(each.signal, each.deviation) for panel in panels for each in panel.bands]
    return list(dict.fromkeys(name for names in shown for name in names if name))


def panel_data(panel: Panel, config: BenchConfig) -> dict[str, Any]:
    """A panel for the page, with the levels of its limits."""
    limits = getattr(config.safety.limits, panel.limits) if panel.limits else None
    levels = {} if limits is None else {"warning": limits.warning, "trip": limits.trip}
    return {
        **{name: getattr(panel, name) for name in ("name", "title", "unit", "least", "least_share")},
        "scale": panel.si_per_unit,
        "limits": {name: level / panel.si_per_unit for name, level in levels.items() if level is not None},
        "series": [_data(each, "name", "width", "dash", "estimated") for each in panel.series],
        "bands": [_data(each, "share", "alpha") for each in panel.bands],
    }


def _data(shown: Series | Interval, *further: str) -> dict[str, Any]:
    known = {name: getattr(shown, name) for name in ("signal", "deviation", *further)}
    return {**known, "colour": VARIABLES[shown.colour]}


#: Of what comes before the first SYNC, the drives' answers say their units.
_MOST_WAITING: Final = 50_000
#: Entries of a journal that are sent one by one: who or what they are about, what happened, and their weight.
_EVENTS: Final[dict[str, tuple[str, str, Weight]]] = {
    "enabled": ("bench", "drives enabled", "note"),
    "stopping": ("bench", "the drives are brought to a stop", "note"),
    "loop_open": ("controller", "{0.path} open for long", "warning"),
    "loop_closed": ("controller", "{0.path} closed after long", "note"),
    "predicted": ("prediction", "{0.path} beyond {0.value:.6g} is expected", "warning"),
    "gap_seen": ("live diagnosis", "model and measurement part since t = {0.value:.3f} s", "warning"),
    "model_proposed": ("live diagnosis", "another model is proposed: {0.path}", "warning"),
    "asked": ("{0.who}", "{0.path}", "operator"),
}


#: The run on the bus of a name, if it is known.
FindRun = Callable[[str], LiveRun | None]


class LiveSamples:
    """Puts the samples of one bench, cycle by cycle from the frames on its bus, into a history.

    Frames become samples by what recovers a run from its trace (`hilbench.results.recover.Decoder`). What no frame
    shows, set-points and what is emulated, is in the journal of the run, where its folder is on this machine; else it
    is unknown.

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
        self._settled: Callable[..., bool] = machine_part(config.machine.kind, "page").settled
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
            if change.what in _EVENTS:
                self._reported.append(change)

    def _store(self) -> None:
        if not self._rows:
            return
        rows = np.array(self._rows, np.float64)
        self._rows.clear()
        shown = rows[:, self._shown]
        if self._simulates_anew:
            self._first_row = rows[0] if self._first_row is None else self._first_row
            self._simulates_anew = not self._settled(self._config, self._names, self._first_row, rows[-1])
            shown[:, self._truth] = np.nan
        self._history.add(rows[:, self._time], shown)


#: What comes within this time is one step of the picture. In between frames wait in their socket: a thread that woke up
#: for each would take the processor from the bench many times in a cycle.
_STEP_S: Final = 0.02
#: A bus that is lost is tried again after this time, and a folder looked at again.
_AGAIN_S: Final = 1.0


class Listener:
    """Receiver of a bench's frames. Everything but `start` and `close` may be called from any thread.

    `open_link` joins the bus; `find_run` has the run on a bus of that name, where its folder is on this machine;
    `clock_s`: the clock by which a bus is silent.
    """

    def __init__(
        self,
        config: BenchConfig,
        open_link: Callable[[], Link],
        find_run: FindRun,
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.config = config
        self.panels = live_panels(config)
        self.history = History(signals_of(self.panels), config.cycle_time_s)
        self.events = Events()
        self.lock = threading.Lock()  #: of all that changes here
        self._open_link = open_link
        self._find_run = find_run
        self._clock_s = clock_s
        self._picture = BusPicture(config)
        self._link: Link | None = None
        self._samples: LiveSamples | None = None
        self._bus_problem = ""
        self._newest_ns = 0  # of the wall clock: when the last SYNC was received
        self._folder: RunFolder | None = None  # of the run that is received, or was last
        self._ended: dict[str, Any] | None = None  # what became of it
        self._look_again_s = 0.0
        self._generation = 0
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)

    def start(self) -> None:
        """Join the bus. Raises BusError where it can't be joined at first, nor a moment later: the timing of a bus
        that is just being set up is not reliable yet."""
        try:
            self._join()
        except BusError:
            self._closing.wait(_AGAIN_S)
            self._join()
        self._thread.start()

    def close(self) -> None:
        """Leave the bus."""
        self._closing.set()
        self._thread.join()
        if self._link is not None:
            self._link.close()

    # -- the thread --------------------------------------------------------------------------------------

    def _join(self) -> None:
        self._link = self._open_link()
        self._samples = LiveSamples(self.config, self.history, self._find_run, self._link.channel)

    def _listen(self) -> None:
        while not self._closing.is_set():
            try:
                if self._link is None:
                    self._join()
                assert self._link is not None
                frames = self._link.receive(_STEP_S)
                if frames:
                    self._closing.wait(_STEP_S)
                    frames += self._link.receive(0.0)
            except BusError as error:
                self._lose(str(error))
                continue
            with self.lock:
                self._bus_problem = ""
                self._take(frames)

    def _lose(self, problem: str) -> None:
        with self.lock:
            self._bus_problem = problem
            self._picture.take([], self._clock_s())
        if self._link is not None:
            with suppress(BusError):
                self._link.close()
            self._link = None
        self._closing.wait(_AGAIN_S)

    def _take(self, frames: list[Frame]) -> None:
        assert self._samples is not None
        self._picture.take(frames, self._clock_s())
        self._samples.take(frames)
        self._newest_ns = next((frame.time_ns for frame in reversed(frames) if frame.can_id == SYNC), self._newest_ns)
        if self.history.generation != self._generation:
            self._generation = self.history.generation
            self._folder = self._ended = None
            self.events.add(Entry(None, "monitor", "a run is received"))
        if self._samples.run is not None:
            self._folder = self._samples.run.folder
        for note in self._picture.new_faults():
            self.events.add(Entry(self._now_s(), note.part, note.text, "fault"))
        self._note_journal(self._samples.log)
        for t_s, change in self._samples.reported():
            self.events.add(event_of(change, t_s))
        if self._samples.problem and self._picture.condition is Condition.RUNNING:  # else a consequence of its end
            problem = Entry(self._now_s(), "bench", self._samples.problem, "fault")
            self.events.put(("problem", self._generation, problem.text), problem)
        self._look_at_folder()

    def _now_s(self) -> float | None:
        return self.history.t_s if isfinite(self.history.t_s) else None

    def _note_journal(self, log: EventLog) -> None:
        for event in log.events():
            key = (self._generation, event.start_s, event.changes[0].path if event.changes else event.text)
            self.events.put(key, Entry(event.start_s, "bench", str(event)))

    def _look_at_folder(self) -> None:
        """Look for the result of a run that has ended."""
        now_s = time.monotonic()
        reported = self._ended is not None and self._ended["report"] is not None  # it is written after the result
        if self._folder is None or reported or now_s < self._look_again_s:
            return
        if self._picture.condition is Condition.RUNNING:
            return
        self._look_again_s = now_s + _AGAIN_S
        if self._folder.result.exists() and not continues(self._folder):
            with suppress(HilbenchError):  # it is being written just now
                result = Result.read(self._folder.result)
                known, self._ended = self._ended, ended(self._folder, result)
                for fault in result.faults if known is None else ():
                    self.events.add(Entry(fault.time_s, fault.source, fault.text, "fault"))

    # -- for others --------------------------------------------------------------------------------------

    def note(self, who: str, text: str, value: float = 0.0) -> None:
        """Somebody has done something: into the list, and into the journal of the run, where there is one."""
        with self.lock:
            folder, cycle = self._folder, self._samples.cycle if self._samples is not None else 0
            if folder is None or self._ended is not None:
                self.events.add(Entry(self._now_s(), who, text, "operator"))
                return
        append_to_journal(folder.journal, Change(cycle, "asked", text, value, who=who))  # and is read there

    def stop_everything(self) -> None:
        """Send the emergency stop on the link that listens. Raises BusError where it can't be sent."""
        link = self._link
        if link is None:
            raise BusError(self._bus_problem or "the bus is not joined")
        send_emergency_stop(link)
        with self.lock:
            self._picture.take(EMERGENCY_STOP)  # a link does not receive what it sends

    def recent_frames(self) -> list[Frame]:
        """Frames of the last cycles."""
        with self.lock:
            return self._picture.recent_frames()

    def state(self) -> dict[str, Any]:
        """The picture as it is now."""
        with self.lock:
            picture, link = self._picture.as_data(), self._link
            received = self._newest_ns > 0
            return {
                **{key: value for key, value in picture.items() if key != "faults"},
                "running": self._picture.condition is Condition.RUNNING,
                "lockstep": self.config.pace == "lockstep",
                "t_s": self._now_s(),
                "values": self.history.latest(),
                "dropped": None if link is None else link.dropped,
                "bus_problem": self._bus_problem,
                "sync_s": self._newest_ns * 1e-9 if received else None,
                "run": None if self._folder is None else self._folder.name,
                "ended": self._ended,
            }


def event_of(change: Change, t_s: float) -> Entry:
    """Page entry of a journal change other than a quantity that was set."""
    source, text, weight = _EVENTS[change.what]
    return Entry(t_s, source.format(change) or "somebody", text.format(change), weight)


def ended(folder: RunFolder, result: Result) -> dict[str, Any]:
    """Page data of a run that is over."""
    return {
        "verdict": result.verdict,
        "faults": [fault.text for fault in result.faults],
        "criteria": [
            {"name": each.name, "passed": each.passed, "value": each.value, "unit": each.unit, "limit": each.limit}
            for each in result.criteria
        ],
        "report": f"/runs/{folder.name}/report" if folder.report.exists() else None,
    }
