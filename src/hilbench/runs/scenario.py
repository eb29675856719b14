"""Scenario tables: stimuli, faults to inject and expectations on one time axis, as CSV or YAML.

A column is headed by a path that can be set (a stimulus, or an effect that is a fault: its value holds from the row's
time on), by ``ramp:PATH`` (straight lines between its values), or by ``expect:SIGNAL`` (``low;high;delay``: from
`delay` seconds after the row on the signal lies within; low or high may be empty; ``-`` ends it). An empty cell
changes nothing. The table ends with its last row.
"""

from __future__ import annotations

import csv
import io
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import takewhile
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench import strict_yaml
from hilbench.bench.bench import Bench
from hilbench.did_you_mean import did_you_mean
from hilbench.errors import UnusableInputError
from hilbench.files import content
from hilbench.runs.criteria import CriterionResult
from hilbench.topology.quantities import LONGEST_S, permitted, rampable_path, settable_path
from hilbench.topology.sample import CycleSample
from hilbench.topology.signals import example_names, find_signal, unit_of

#: Bytes of a table, and columns of it, at most.
_MOST_BYTES, _MOST_COLUMNS = 16_000_000, 1000
_TIME = "t_s"
_RAMP, _EXPECT = "ramp:", "expect:"
_END = "-"


@dataclass(frozen=True)
class Expectation:
    """A signal lies within `low` … `high` from `start_s` to `end_s` of the table's time."""

    signal: str
    low: float
    high: float
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Scenario:
    """A table. `jumps` and `ramps`: (time, value) of each path, in order of time."""

    duration_s: float
    jumps: Mapping[str, list[tuple[float, float]]]
    ramps: Mapping[str, list[tuple[float, float]]]
    expectations: list[Expectation]

    def run(self, bench: Bench, judged: list[CriterionResult]) -> None:
        """Run it from now on; the verdict on each expectation is added to `judged` when its time is over."""
        cycle_s = bench.config.cycle_time_s
        due = {path: list(points) for path, points in self.jumps.items()}
        waiting = [_Watched(expectation) for expectation in self.expectations]
        cycles, k = round(self.duration_s / cycle_s) + 1, 0
        while k < cycles:
            t_s = k * cycle_s
            for path, points in due.items():
                while points and points[0][0] <= t_s + cycle_s / 2:
                    bench.set(path, points.pop(0)[1])
            if not waiting and len(self.ramps) == 1:
                (path,) = self.ramps
                values = self._smooth(self.ramps[path], due, range(k, cycles), cycle_s)
                if len(values):
                    bench.follow_values(path, values)
                    k += len(values)
                    continue
            for path, points in self.ramps.items():
                if points[0][0] <= t_s <= points[-1][0] + cycle_s:
                    bench.set(path, _between(points, t_s))
            sample = bench.cycle()
            for watched in waiting:
                watched.see(sample, t_s)
            judged += [watched.verdict() for watched in waiting if watched.expectation.end_s <= t_s]
            waiting = [watched for watched in waiting if watched.expectation.end_s > t_s]
            k += 1
        judged += [watched.verdict() for watched in waiting]

    @staticmethod
    def _smooth(
        points: list[tuple[float, float]], due: Mapping[str, list[tuple[float, float]]], cycles: range, cycle_s: float
    ) -> NDArray[np.float64]:
        """Values of a ramp in these cycles, as long as it moves and nothing jumps."""
        jump_s = min((waiting[0][0] for waiting in due.values() if waiting), default=math.inf)
        times = (k * cycle_s for k in cycles)
        moved = takewhile(
            lambda t_s: points[0][0] <= t_s <= points[-1][0] + cycle_s and not jump_s <= t_s + cycle_s / 2, times
        )
        return np.array([_between(points, t_s) for t_s in moved])


@dataclass
class _Watched:
    """An expectation, and the value of its signal that was the farthest out of it, or the nearest to its bound."""

    expectation: Expectation
    worst: float | None = None
    _least: float = field(default=math.inf)

    def see(self, sample: CycleSample, t_s: float) -> None:
        wanted = self.expectation
        if wanted.start_s <= t_s < wanted.end_s:
            value = float(getattr(sample, wanted.signal))
            inside = min(value - wanted.low, wanted.high - value)
            if not inside >= self._least:
                self.worst, self._least = value, inside

    def verdict(self) -> CriterionResult:
        wanted = self.expectation
        known = self.worst is not None and math.isfinite(self.worst)
        low, high = ("" if math.isinf(bound) else f"{bound:g}" for bound in (wanted.low, wanted.high))
        return CriterionResult(
            name=f"{wanted.signal} from t = {wanted.start_s:g} s of the table",
            value=self.worst if known else None,
            limit=f"{low} … {high}" if low and high else f"≥ {low}" if low else f"≤ {high}",
            unit=unit_of(wanted.signal),
            passed=known and self._least >= 0,
            reason=None if known else f"{wanted.signal} has no value in its time",
        )


def _between(points: list[tuple[float, float]], t_s: float) -> float:
    behind = bisect_right(points, t_s, key=itemgetter(0))
    before, after = points[max(behind - 1, 0)], points[min(behind, len(points) - 1)]
    if after[0] <= before[0]:
        return before[1]
    return before[1] + (after[1] - before[1]) * (t_s - before[0]) / (after[0] - before[0])


# -- reading ---------------------------------------------------------------------------------------------------------


def read_scenario(path: Path) -> Scenario:
    """Read a table. Raises UnusableInputError with file, line, column, what was found and what was expected."""
    rows = list(_yaml_rows(path) if path.suffix.lower() in (".yaml", ".yml") else _csv_rows(path))
    times: list[float] = []
    for place, row in rows:
        if _TIME not in row:
            raise UnusableInputError(place, f"no {_TIME}, expected the row's time")
        times.append(_number(place, _TIME, row[_TIME]))
        if times[-1] > LONGEST_S:
            raise UnusableInputError(place, f"{_TIME} is {times[-1]:g}, expected a time in s, up to {LONGEST_S:g}")
        if times[-1] < (times[-2] if len(times) > 1 else 0.0):
            raise UnusableInputError(
                place, f"{_TIME} is {times[-1]:g}, expected no earlier than the row before, from 0 on"
            )
    if len(rows) < 2:
        raise UnusableInputError(path, f"{len(rows)} row(s), expected at least two: the last one is the end")
    jumps: dict[str, list[tuple[float, float]]] = {}
    ramps: dict[str, list[tuple[float, float]]] = {}
    expectations: list[Expectation] = []
    for column in dict.fromkeys(name for _, row in rows for name in row if name != _TIME):
        cells = [
            (place, t_s, row[column])
            for t_s, (place, row) in zip(times, rows, strict=True)
            if row.get(column) is not None
        ]
        if column.startswith(_EXPECT):
            expectations += _expectations(column.removeprefix(_EXPECT), cells, times[-1])
            continue
        try:
            target = rampable_path(column.removeprefix(_RAMP)) if column.startswith(_RAMP) else settable_path(column)
        except ValueError as error:
            raise UnusableInputError(cells[0][0], f"column '{column}', expected {error}") from error
        points = [(t_s, _value(place, column, target, cell)) for place, t_s, cell in cells]
        (ramps if column.startswith(_RAMP) else jumps)[target] = points
    return Scenario(times[-1], jumps, ramps, sorted(expectations, key=lambda wanted: wanted.end_s))


def _expectations(signal: str, cells: list[tuple[str, float, Any]], end_s: float) -> Iterator[Expectation]:
    if find_signal(signal) is None:
        meant = did_you_mean(signal, example_names())
        raise UnusableInputError(cells[0][0], f"column '{_EXPECT}{signal}', expected a signal of the recording{meant}")
    ends = [t_s for _, t_s, _ in cells[1:]] + [end_s]
    for (place, t_s, cell), until_s in zip(cells, ends, strict=True):
        if cell == _END:
            continue
        parts = str(cell).split(";")
        if len(parts) not in (2, 3) or not any(part.strip() for part in parts[:2]):
            raise UnusableInputError(place, f"{_EXPECT}{signal} is '{cell}', expected low;high;delay")
        low, high = (
            _number(place, signal, part) if part.strip() else bound
            for part, bound in zip(parts[:2], (-math.inf, math.inf), strict=True)
        )
        delay_s = _number(place, signal, parts[2]) if len(parts) == 3 else 0.0
        if low > high or delay_s < 0 or t_s + delay_s >= until_s:
            raise UnusableInputError(
                place, f"{_EXPECT}{signal} is '{cell}', expected low up to high, and a delay before {until_s:g} s"
            )
        yield Expectation(signal, low, high, t_s + delay_s, until_s)


def _number(place: str, column: str, cell: Any) -> float:
    try:
        value = float(cell)
    except (TypeError, ValueError):
        value = math.nan
    if isinstance(cell, bool) or not math.isfinite(value):
        raise UnusableInputError(place, f"{column} is '{cell}', expected a number")
    return value


def _value(place: str, column: str, path: str, cell: Any) -> float:
    value, allowed = _number(place, column, cell), permitted(path)
    if not allowed.holds(value):
        raise UnusableInputError(place, f"{column} is '{cell}', expected {allowed}")
    return value


def _csv_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    try:
        reader = csv.reader(io.StringIO(content(path, _MOST_BYTES).decode("utf-8-sig"), newline=""))
        header = [name.strip() for name in next(reader, [])]
        if len(header) > _MOST_COLUMNS:
            raise UnusableInputError(f"{path}:1", f"{len(header)} columns, expected at most {_MOST_COLUMNS}")
        for cells in reader:
            place = f"{path}:{reader.line_num}"
            if len(cells) > len(header):
                raise UnusableInputError(place, f"{len(cells)} cells, expected {len(header)} as in the header row")
            row = {name: cell.strip() for name, cell in zip(header, cells, strict=False) if cell.strip()}
            if row:
                yield place, row
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise UnusableInputError(path, f"cannot be read ({reason}), expected a table (CSV or YAML)") from error


def _yaml_rows(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    document = strict_yaml.load(path)
    if not isinstance(document.data, list):
        raise UnusableInputError(document.place(), "no list, expected a list of rows")
    for number, row in enumerate(document.data):
        if not isinstance(row, dict):
            raise UnusableInputError(document.place((number,)), f"{row!r}, expected a row: {_TIME} and columns")
        yield document.place((number,)), row
