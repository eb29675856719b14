"""Long recordings made short: full rate around what happened, least, mean and largest values elsewhere.

What lies elsewhere is cut into stretches of equal sample count, and each becomes three samples, at the times of its
first, middle and last one: the least value of each channel, its mean, its largest, or the largest first where it falls.
Counts and bit fields are those of these samples. No spike is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.results.mdf import Columns, MdfPieces
from hilbench.runs.events import Event, signal_events
from hilbench.topology.main_quantities.of_kind import recorded_quantities
from hilbench.topology.signal_kinds import TIME

#: Values of a recording that are kept in memory; of a longer one it is made as short as that. 24 MB: with what
#: consists of them that, beside a process of 290 MB with all its machine code, is below 400 MB.
MOST_VALUES: Final = 3_000_000
#: Full rate from before an event (the settled part of what precedes it is 5 s, `runs.figures.SETTLED_S`) to after it.
BEFORE_S: Final = 6.0
AFTER_S: Final = 10.0
#: Share of the samples that may be kept at full rate.
_FULL_RATE: Final = 0.5
#: In a recording with full rate around events three samples stand for so long elsewhere, s; they are farther apart than
#: those of any bench (`cycle_time_s` is at most 0.1).
STRETCH_S: Final = 1.0
GAP_S: Final = 0.25 * STRETCH_S
#: Samples that a stretch becomes.
_PER_STRETCH: Final = 3


@dataclass(frozen=True)
class FullRate:
    """Intervals of time (s) in which every sample is kept, `starts` and `ends` rising."""

    starts: Array
    ends: Array

    @classmethod
    def around(cls, times_s: Iterable[float], share: float = 1.0) -> FullRate:
        """Intervals from before to after each time; of narrower ones so large a `share`."""
        times = np.unique(np.fromiter(times_s, np.float64))
        starts, ends = times - share * BEFORE_S, times + share * AFTER_S
        first = np.ones(len(times), bool)
        first[1:] = starts[1:] > ends[:-1]
        last = np.append(first[1:], True)[: len(times)]
        return cls(starts[first], ends[last])

    def length_s(self, first_s: float, last_s: float) -> float:
        """Length of all intervals together, as far as they lie between two times."""
        return float(np.sum(np.minimum(self.ends, last_s) - np.maximum(self.starts, first_s)))

    def holds(self, time_s: Array) -> NDArray[np.bool_]:
        """True for each of these times (n,) within an interval."""
        at = np.searchsorted(self.starts, time_s, side="right") - 1
        return (at >= 0) & (time_s <= np.append(self.ends, -np.inf)[at])


def times_of(events: Iterable[Event]) -> Iterator[float]:
    """Times at which something happens: a ramp begins, and ends."""
    for event in events:
        yield from {event.start_s, event.end_s}


def thinned(columns: Columns, full_rate: FullRate, stretch: int) -> dict[str, NDArray[Any]]:
    """Samples as this module says, of stretches of so many of them. `columns`: of equal length, the time is one."""
    time_s = np.asarray(columns[TIME], np.float64)
    starts = _starts(full_rate.holds(time_s), stretch)
    sizes = np.diff(np.append(starts, len(time_s)))
    long = sizes >= _PER_STRETCH
    first = starts[long]
    middle, last = first + sizes[long] // 2, first + sizes[long] - 1
    keep = np.repeat(~long, sizes)
    keep[first] = keep[middle] = keep[last] = True
    found = {}
    for name, values in columns.items():
        data = np.array(values)
        if name != TIME and data.dtype.kind == "f":
            known = np.isfinite(data)
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = np.add.reduceat(np.where(known, data, 0.0), starts) / np.add.reduceat(known.astype(int), starts)
            low, high = np.fmin.reduceat(data, starts), np.fmax.reduceat(data, starts)
            rising = data[last] >= data[first]  # so that a motion stays one
            data[first] = np.where(rising, low[long], high[long])
            data[last] = np.where(rising, high[long], low[long])
            data[middle] = mean[long]
        found[name] = data[keep]
    return found


def _starts(full: NDArray[np.bool_], stretch: int) -> NDArray[np.int_]:
    """First samples of stretches: each one of full rate, and every so many others of those that follow each other."""
    at = np.arange(len(full))
    begins = np.ones(len(full), bool)
    begins[1:] = full[1:] != full[:-1]
    since = at - np.maximum.accumulate(np.where(begins, at, 0))
    return np.flatnonzero(full | (since % stretch == 0))


class Survey:
    """Survey of a recording, piece by piece: when something happens, how long it is, its sample time."""

    def __init__(self, names: Iterable[str]) -> None:
        self._quantities = recorded_quantities(names)
        self.signals = [quantity.signal for quantity in self._quantities]  #: those that are looked at
        self._before: dict[str, NDArray[Any]] = {}  # the last sample of the piece before
        self.times_s: set[float] = set()
        self.first_s, self.last_s, self.sample_s = np.inf, -np.inf, np.inf

    def take(self, piece: Columns) -> None:
        """The next samples."""
        names = [TIME, *self.signals]
        both = {
            name: np.concatenate([self._before[name], piece[name]]) if self._before else np.asarray(piece[name])
            for name in names
        }
        self._before = {name: values[-1:] for name, values in both.items()}
        time_s = both[TIME]
        self.first_s, self.last_s = min(self.first_s, float(time_s[0])), float(time_s[-1])
        if len(time_s) > 1:
            self.sample_s = min(self.sample_s, float(np.min(np.diff(time_s))))
            for quantity in self._quantities:
                self.times_s.update(times_of(signal_events(time_s, both[quantity.signal], quantity.path)))


def reduced(pieces: MdfPieces, events: Callable[[float], Sequence[Event]]) -> dict[str, NDArray[Any]]:
    """Reduce all channels of a long recording to at most `MOST_VALUES` values; `events`: those that no signal shows, by
    the sample time (s)."""
    survey = Survey(column.name for column in pieces.columns)
    for piece in pieces.having(survey.signals):
        survey.take(piece)
    most = MOST_VALUES // len(pieces.columns)
    times_s = survey.times_s | set(times_of(events(survey.sample_s))) | {survey.first_s, survey.last_s}
    full_rate = FullRate.around(times_s)
    wanted = full_rate.length_s(survey.first_s, survey.last_s) / survey.sample_s
    if wanted > _FULL_RATE * most:
        full_rate = FullRate.around(times_s, _FULL_RATE * most / wanted)
        wanted = _FULL_RATE * most
    stretch = max(_PER_STRETCH, int(np.ceil(_PER_STRETCH * pieces.rows / (most - wanted))))
    return joined(thinned(piece, full_rate, stretch) for piece in pieces)


def joined(pieces: Iterable[Columns]) -> dict[str, NDArray[Any]]:
    """Pieces behind each other, channel by channel: in no more memory than they take, and a channel."""
    kept = [dict(piece) for piece in pieces]
    return {name: np.concatenate([piece.pop(name) for piece in kept]) for name in list(kept[0])} if kept else {}
