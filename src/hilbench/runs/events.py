"""Events of a run: its steps (a quantity jumped), its ramps (it moved), and marks (the twin was lost, …).

The journal of the bench says exactly what was set and when (`EventLog`). Where there is none, or where a quantity
changed by itself (an effect that steps at a time of its own), the recorded signals show it (`signal_events`); slow
drift is no event. `merged` makes one list of both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.arrays import Array
from hilbench.bench.reports.change import Change
from hilbench.topology.main_quantities.of_kind import find_quantity, recorded_quantities
from hilbench.topology.quantities import MODEL_CHANGE
from hilbench.topology.web_line_quantities import alike

Channels = Mapping[str, NDArray[Any]]

#: A quantity that changes by more than this share from one sample to the next has stepped; slower is drift.
STEP_SHARE: Final = 1e-3
#: Changes of one quantity that are no farther apart belong together, in samples.
_GAP: Final = 3
#: What takes no longer than this is a step that ends with its last sample, not a ramp: samples, or s.
_STEP_SAMPLES: Final = 5
_STEP_S: Final = 0.02
#: A change within a ramp that is so many times the ramp's own is a step within it.
_STANDS_OUT: Final = 5.0

#: What the mark of a tension loop that is open for long says after its name, and that of the end of that.
_OPEN, _CLOSED = " open for long", " closed after long"
_MARKS: Final = {
    "loop_open": f"{{path}}{_OPEN}",
    "loop_closed": f"{{path}}{_CLOSED}",
    "twin_lost": "twin lost",
    "twin_back": "twin is back",
    "effect_named": "named: {path}",
    "effect_gone": "gone: {path}",
    "effect_dismissed": "not confirmed: {path}",
    "model_applied": "in the model: {path}",
    "model_refused": "refused: {path}",
    "model_announced": "announced: {path}",
}


@dataclass(frozen=True)
class Changed:
    """A quantity (`hilbench.topology.quantities`, SI) and its values around an event; None where unknown."""

    path: str
    before: float | None
    after: float | None

    def __str__(self) -> str:
        """Text for a table or the edge of a picture: ``E +20.7 %``, ``set-point 80 → 95 N``."""
        known = find_quantity(self.path)
        if known is not None and known.emulated and self.before and self.after is not None:
            return f"{known.short} {100 * (self.after / self.before - 1):+.3g} %".replace("-", "−")
        name, unit = (self.path.split("effects.", 1)[-1], "") if known is None else (known.short, known.unit)
        after = f"{_text(self.after)} {unit}".strip()
        return f"{name} {_text(self.before)} → {after}" if self.before is not None else f"{name} → {after}"


def _text(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}".replace("-", "−")


@dataclass(frozen=True)
class Event:
    """A step, a ramp or a mark. `start_s`: the first sample that shows it; `end_s`: the first with its last value."""

    kind: Literal["step", "ramp", "mark"]
    start_s: float
    end_s: float
    changes: tuple[Changed, ...] = field(default=())
    text: str = ""

    def __str__(self) -> str:
        return ", ".join(map(str, self.changes)) or self.text

    def of(self, path: str) -> Changed | None:
        """Change of a quantity by the event; None if it did not change."""
        return next((change for change in self.changes if change.path == path), None)


def of_open_loop(event: Event) -> bool:
    """True if it reports that a tension loop is open for long, or closed again."""
    return event.text.endswith((_OPEN, _CLOSED))


def open_loops(events: Sequence[Event], start_s: float, until_s: float) -> set[str]:
    """The tension loops, as messages call them, that were open for long at any time from `start_s` to `until_s`."""
    found: set[str] = set()
    for event in events:
        if event.start_s <= until_s and event.text.endswith(_OPEN):
            found.add(event.text.removesuffix(_OPEN))
        elif event.start_s <= start_s and event.text.endswith(_CLOSED):
            found.discard(event.text.removesuffix(_CLOSED))
    return found


def find_events(channels: Channels, journal: Sequence[Event] = ()) -> list[Event]:
    """Events of a recording, in order of time, including those of its journal (`journal_events`)."""
    time_s = np.asarray(channels["t_s"], np.float64)
    if len(time_s) < 2:
        return []
    shown = [
        event
        for quantity in recorded_quantities(channels)
        for event in signal_events(time_s, channels[quantity.signal], quantity.path)
    ]
    sample_s = float(np.min(np.diff(time_s)))  # a long recording has fewer samples where nothing happens
    within = [
        event
        for event in journal
        if event.start_s <= time_s[-1] and (event.end_s if event.kind == "ramp" else event.start_s) > time_s[0]
    ]
    return merged(within, shown, 1.5 * sample_s)


class EventLog:
    """Collects what the bench notes (`Change`) as events, one change at a time: a ramp is one, however long it is.

    What was set before the drives were enabled is left out.
    """

    def __init__(self, cycle_time_s: float) -> None:
        self._cycle_s = cycle_time_s
        self._began: int | None = None
        self._done: list[Event] = []
        self._open: dict[str, _Sets] = {}

    def time_s(self, cycle: int) -> float:
        """The time of a cycle in the recording; of one before the drives were enabled 0."""
        return 0.0 if self._began is None else self._time_s(cycle)

    def add(self, change: Change) -> None:
        """The next change, in the order of the cycles."""
        if change.what == "enabled":
            self._began = change.cycle
        elif self._began is None:
            return
        elif change.what == "set":
            if change.path != MODEL_CHANGE:  # the marks say what became of it
                self._set(change)
        elif change.what in _MARKS:
            at_s = change.value if change.what == "loop_open" else self._time_s(change.cycle)
            self._done.append(Event("mark", at_s, at_s, text=_MARKS[change.what].format(path=change.path)))

    def events(self) -> list[Event]:
        """Events until now, in order of time and in the time of the recording."""
        unfinished = [event for sets in self._open.values() if (event := self._event(sets)) is not None]
        return sorted([*self._done, *unfinished], key=lambda event: event.start_s)

    def _set(self, change: Change) -> None:
        sets = self._open.get(change.path)
        if sets is not None and change.cycle - sets.last.cycle <= _GAP:
            sets.moved |= change.value != sets.before
            sets.last = change
            return
        known = None if sets is None else sets.last.value
        if sets is not None and (event := self._event(sets)) is not None:
            self._done.append(event)
        before = known if change.before is None else change.before
        self._open[change.path] = _Sets(change, change, before, moved=change.value != before)

    def _event(self, sets: _Sets) -> Event | None:
        if not sets.moved:
            return None
        start_s, end_s = self._time_s(sets.first.cycle), self._time_s(sets.last.cycle)
        cycles = sets.last.cycle - sets.first.cycle + 1
        return _event(sets.last.path, start_s, end_s, cycles, sets.before, sets.last.value)

    def _time_s(self, cycle: int) -> float:
        return (cycle - (self._began or 0)) * self._cycle_s


@dataclass
class _Sets:
    """Changes of one quantity in cycles that follow each other."""

    first: Change
    last: Change
    before: float | None
    moved: bool


def journal_events(changes: Iterable[Change], cycle_time_s: float) -> list[Event]:
    """Events of a journal."""
    log = EventLog(cycle_time_s)
    for change in changes:
        log.add(change)
    return log.events()


def signal_events(t_s: ArrayLike, values: ArrayLike, path: str) -> list[Event]:
    """Steps and ramps of a recorded quantity. Of one that is emulated steps only, as it may drift by itself."""
    quantity = find_quantity(path)
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    largest = float(np.max(np.abs(data), initial=0.0, where=np.isfinite(data)))
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.diff(data)
        drifts = quantity is not None and quantity.emulated
        least = STEP_SHARE * np.abs(data[:-1]) if drifts else np.full(len(changes), 1e-9 * largest)
        moved = np.flatnonzero(np.abs(changes) > least) + 1
    events = []
    for at in np.split(moved, np.flatnonzero(np.diff(moved) > _GAP) + 1) if len(moved) else ():
        steps = _within_a_ramp(changes[at - 1], largest)
        events += [_event(path, time_s[at[k]], time_s[at[k]], 1, data[at[k] - 1], data[at[k]]) for k in steps]
        first, last = int(at[0]), int(at[-1])
        if abs(data[last] - data[first - 1]) > STEP_SHARE * largest or np.ptp(data[at]) > STEP_SHARE * largest:
            samples = last - first + 1
            events.append(_event(path, time_s[first], time_s[last], samples, data[first - 1], data[last]))
    return events


def _within_a_ramp(changes: Array, largest: float) -> list[int]:
    """Changes of a ramp that are steps within it, by number."""
    if len(changes) <= _STEP_SAMPLES:
        return []
    sizes = np.abs(changes)
    out = (sizes > _STANDS_OUT * np.median(sizes)) & (sizes > STEP_SHARE * largest)
    return [int(at) for at in np.flatnonzero(out)]


def _event(path: str, start_s: float, end_s: float, samples: int, before: float | None, after: float) -> Event:
    quick = samples <= _STEP_SAMPLES or end_s - start_s <= _STEP_S
    changed = Changed(path, None if before is None else float(before), float(after))
    return Event("step" if quick else "ramp", float(start_s), float(end_s), (changed,))


def merged(journal: Iterable[Event], shown: Iterable[Event], same_s: float) -> list[Event]:
    """Merge the journal's events and those only in the signals, in order of time; steps at the same time are one."""
    entries = list(journal)
    found = entries + [event for event in shown if not any(_same(event, known, same_s) for known in entries)]
    result: list[Event] = []
    for event in sorted(found, key=lambda event: (event.start_s, event.kind)):
        at = next((k for k, e in enumerate(result) if e.kind == "step" and event.start_s - e.start_s <= same_s), None)
        if event.kind == "step" and at is not None:
            known = result[at]
            end_s = max(known.end_s, event.end_s)
            result[at] = replace(known, end_s=end_s, changes=known.changes + event.changes)
        else:
            result.append(event)
    return result


def _same(event: Event, known: Event, same_s: float) -> bool:
    overlaps = event.start_s <= known.end_s + same_s and known.start_s <= event.end_s + same_s
    return overlaps and any(known.of(path) is not None for change in event.changes for path in alike(change.path))
