"""The one registry of signals: each is declared once, by the kind of part that has it, and instantiated per part.

What a recording, a condition, a limit, a report or the monitor knows of a signal (name, unit, meaning, group) is
here. Names are those of the design (files: recording): a name carries its unit; the number of the axis or span, or the
name of the load motor, is in it where the declaration has ``{axis}``, ``{span}`` or ``{load_motor}``. The number of
a span is left out where there is only one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Final

from hilbench.machine_kinds import machine_part, recorded
from hilbench.plant.unit_names import unit_of_name
from hilbench.topology.signal_kinds import Per, Signal, SignalKind
from hilbench.topology.web_line_signals import LINE_SPEED_SIGNAL


@dataclass(frozen=True, slots=True)
class Shape:
    """Parts of a bench by their number: driven axes, spans, load motors by name, and which spans are estimated and
    controlled, by their numbers from 1.

    Of a line with more than driven rollers: the number of the driven axis before each span, the spans whose tension the
    twin reports, dancers, accumulators and reels by name, which of these have a sensor of their position or radius,
    which carriages have a loop of their position, which of these a force that is fed forward, which axes are reels in
    torque mode, the idlers that are load cells, and whether the last axis is a reel, whose speed is not that of the
    line.
    """

    axes: int
    load_motors: tuple[str, ...] = ()
    spans: int = 0
    estimated: tuple[int, ...] = ()
    controlled: tuple[int, ...] = ()
    axes_before: tuple[int, ...] = ()
    listed: tuple[int, ...] = ()
    carriages: tuple[str, ...] = ()
    reels: tuple[str, ...] = ()
    measured: tuple[str, ...] = ()
    positioned: tuple[str, ...] = ()
    pushed: tuple[str, ...] = ()
    torqued: tuple[int, ...] = ()
    cells: tuple[str, ...] = ()
    winds: bool = False

    @property
    def has_stations(self) -> bool:
        """True if there is more than driven rollers."""
        return self.spans > max(self.axes - 1, 0)

    @property
    def stations(self) -> tuple[str, ...]:
        """Names of carriages, then of reels."""
        return (*self.carriages, *self.reels)

    @property
    def sensors(self) -> tuple[tuple[str, str], ...]:
        """Each station with a sensor, and the signal of that: carriages, reels, then load cells."""
        placed = (
            (name, f"{'x' if name in self.carriages else 'r'}_{name}_meas_m")
            for name in self.stations
            if name in self.measured
        )
        return (*placed, *((cell, f"F_{cell}_meas_N") for cell in self.cells))

    @property
    def forces(self) -> tuple[tuple[str, str], ...]:
        """Each carriage whose force is sent ahead, and the signal of that."""
        return tuple((name, f"f_{name}_cmd_N") for name in self.pushed)

    def axis_before(self, number: int) -> int:
        """Number of the driven axis before the span of that number; the one behind it is the next."""
        return self.axes_before[number - 1] if self.axes_before else number

    @property
    def simulated(self) -> tuple[int, ...]:
        """Spans whose tension the twin publishes."""
        return self.listed or tuple(range(1, self.spans + 1))

    def numbered(self, number: int) -> str:
        """Number of a span in names: empty where there is only one."""
        return str(number) if self.spans > 1 else ""

    def shows(self, number: int) -> int:
        """The span whose estimate a span goes by: itself, or the nearest at which something is estimated; of two the
        one before it, whose web comes in."""
        return min(self.estimated, key=lambda other: (abs(other - number), other))

    def _parts(self, per: Per) -> Iterable[str]:
        parts: Mapping[Per, Iterable[str | int]] = {
            Per.LOAD_MOTOR: self.load_motors,
            Per.CARRIAGE: self.carriages,
            Per.REEL: self.reels,
            Per.MEASURED_CARRIAGE: [name for name in self.carriages if name in self.measured],
            Per.MEASURED_REEL: [name for name in self.reels if name in self.measured],
            Per.POSITIONED_CARRIAGE: self.positioned,
            Per.PUSHED_CARRIAGE: self.pushed,
            Per.CELL: self.cells,
            Per.WINDER: [""] if self.winds else [],
            Per.AXIS: range(1, self.axes + 1),
            Per.TORQUED_AXIS: self.torqued,
            Per.SPAN: range(1, self.spans + 1),
            Per.ESTIMATED: self.estimated,
            Per.CONTROLLED: self.controlled,
            Per.SIMULATED: self.simulated,
        }
        return map(str, parts[per])

    def instances(self, kind: SignalKind) -> Iterator[Signal]:
        """The signals of a declaration, one for each part that has it."""
        if kind.per is Per.BENCH:
            yield kind.of("")
            return
        for part in self._parts(kind.per):
            if kind.per.is_of_span:
                number = int(part)
                yield kind.of(part, number=self.numbered(number), behind=str(self.axis_before(number) + 1))
            else:
                yield kind.of(part)


def signals_of(kind: str, shape: Shape) -> tuple[Signal, ...]:
    """The signals of a bench in recording order. Raises UnusableInputError for an unknown kind of machine."""
    return tuple(signal for each in machine_part(kind, "topology").SIGNALS for signal in shape.instances(each))


@cache
def find_signal(name: str) -> Signal | None:
    """Signal declared under a name, whatever the bench; None for a name that no kind of part has."""
    topologies = recorded("topology").values()
    found = [kind for each in topologies for kind in each.SIGNALS if _pattern(kind).fullmatch(name)]
    # `tau_load_cmd_Nm` is the command of a motor `load` before it is the torque of a motor `load_cmd`.
    found.sort(key=lambda kind: len(kind.name), reverse=True)
    return _named(found[0], name) if found else None


_NAME: Final = r"[A-Za-z]\w*?"
_PATTERNS: Final = {
    "axis": r"[1-9]\d*",
    "next": r"[1-9]\d*",
    "span": r"(?:[1-9]\d*)?",
    "load_motor": _NAME,
    "carriage": _NAME,
    "reel": _NAME,
    "cell": _NAME,
}


@cache
def _pattern(kind: SignalKind) -> re.Pattern[str]:
    return re.compile(kind.name.format_map({key: f"(?P<{key}>{pattern})" for key, pattern in _PATTERNS.items()}))


def _named(kind: SignalKind, name: str) -> Signal:
    found = _pattern(kind).fullmatch(name)
    part = "1" if found is None else _part(kind, found)
    return Signal(name, kind.unit, kind.of(part).description, kind.group, kind.integer)


def _part(kind: SignalKind, found: re.Match[str]) -> str:
    """The number or name of the part whose signal a name is."""
    parts = found.groupdict()
    return parts.get(kind.per.placeholder) or (str(int(parts["next"]) - 1) if parts.get("next") else "1")


@cache
def smallest_shapes() -> Mapping[str, Shape]:
    """The smallest bench of each kind of machine with recordings of its own."""
    return {kind: each.SMALLEST for kind, each in recorded("topology").items()}


def example_names() -> list[str]:
    """The names that the smallest bench of each kind of machine has: what a misspelt name is compared with."""
    smallest = (signals_of(kind, shape) for kind, shape in smallest_shapes().items())
    return list(dict.fromkeys(signal.name for signals in smallest for signal in signals))


def shape_of(names: Iterable[str]) -> Shape:
    """The bench whose recording has signals with these names, without its load motors.

    A name without the number of a span is that of the only one. Of a line with more than driven rollers the axis before
    a span is known where something is estimated, else 0.
    """
    given = list(names)
    found: dict[Per, set[int]] = {per: set() for per in Per}
    named: dict[Per, dict[str, None]] = {per: {} for per in Per}
    before: set[int] = set()  # axes before what is estimated
    for kind in recorded("topology")[kind_of(given)].SIGNALS:
        parts = [_part(kind, match) for match in map(_pattern(kind).fullmatch, given) if match is not None]
        if not kind.per.is_counted:
            named[kind.per] |= dict.fromkeys(parts)
        elif "{next}" in kind.name:
            before |= set(map(int, parts))
        else:
            found[kind.per] |= set(map(int, parts))
    estimated = sorted(found[Per.ESTIMATED] or before)
    count = max([*estimated, *(number for per in Per if per.is_of_span for number in found[per])], default=0)
    beyond = len(before) == len(estimated) and sorted(before) != estimated  # more than driven rollers
    axes = dict(zip(estimated, sorted(before), strict=False))
    return Shape(
        axes=max(found[Per.AXIS], default=0),
        spans=count,
        estimated=tuple(estimated),
        controlled=tuple(sorted(found[Per.CONTROLLED])),
        axes_before=tuple(axes.get(number, 0) for number in range(1, count + 1)) if beyond else (),
        carriages=tuple(named[Per.CARRIAGE]),
        reels=tuple(named[Per.REEL]),
        pushed=tuple(named[Per.PUSHED_CARRIAGE]),
        torqued=tuple(sorted(found[Per.TORQUED_AXIS])),
        cells=tuple(named[Per.CELL]),
        winds=LINE_SPEED_SIGNAL in given,
    )


def kind_of(names: Iterable[str]) -> str:
    """Kind of machine that has most of the signals with these names, the first of them where several have."""
    given = list(names)
    return max(recorded("topology"), key=lambda kind: sum(_has(kind, name) for name in given))


@cache
def _has(kind: str, name: str) -> bool:
    return any(_pattern(each).fullmatch(name) for each in recorded("topology")[kind].SIGNALS)


def unit_of(name: str) -> str:
    """SI unit of a channel: as declared, or, for a channel that no part has, from the suffix of its name."""
    signal = find_signal(name)
    if signal is not None:
        return signal.unit
    unit = unit_of_name(name)
    return "" if unit == "1" else unit
