"""The one registry of signals: each is declared once, by the kind of part that has it, and instantiated per part.

What a recording, a condition, a limit, a report or the monitor knows of a signal (name, unit, meaning, group) stands
here. Names are those of the design (files: recording): a name carries its unit; the number of the axis or span, or the
name of the load motor, stands in it where the declaration has ``{axis}``, ``{span}`` or ``{load_motor}``. The number of
a span is left out where there is only one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from typing import Final


class Per(StrEnum):
    """What has a signal of its own."""

    BENCH = "bench"
    AXIS = "axis"  #: a driven axis of the machine
    LOAD_MOTOR = "load_motor"
    SPAN = "span"


@dataclass(frozen=True, slots=True)
class Signal:
    """One channel of a recording.

    `unit` is the SI unit as MDF4 shows it ("" for a pure number); `group` says who knows the value:
    ``time``, ``command`` (the bench), ``measured`` (the drives), ``boundary`` (given to the process),
    ``load`` (load motors and load model), ``twin``, ``truth`` (only a simulated bench has it; diagnosis never
    reads it) or ``bus``. `integer` marks counts and bit fields.
    """

    name: str
    unit: str
    description: str
    group: str
    integer: bool = False


@dataclass(frozen=True, slots=True)
class SignalKind:
    """The declaration of a signal, as in `Signal`; `per` says which parts have one, by whose number or name the
    placeholders of `name` and `description` are filled. ``{next}`` is the number of the axis behind a span."""

    name: str
    unit: str
    description: str
    group: str
    per: Per = Per.BENCH
    integer: bool = False

    def of(self, part: str, *, number: str | None = None) -> Signal:
        """The signal of one part; `number`: how the part is counted in a name, if not as in the description."""
        following = str(int(part) + 1) if part.isdecimal() else ""
        in_name = part if number is None else number
        return Signal(
            self.name.format_map({self.per: in_name, "next": following}),
            self.unit,
            self.description.format_map({self.per: part, "next": following}),
            self.group,
            self.integer,
        )


#: Name of the time channel, the common time base of all others.
TIME: Final = "t_s"

_TIME: Final = (SignalKind(TIME, "s", "bus time: number of the SYNC times the cycle", "time"),)


def _axes(unit: str, where: str, what: str) -> tuple[SignalKind, ...]:
    """What every driven axis has, in the machine's unit of position; `where` and `what` say of what."""
    speed, per = f"{unit}/s", Per.AXIS
    suffix = f"{unit}_s"
    return (
        SignalKind(f"v{{axis}}_cmd_{suffix}", speed, f"velocity command of axis {{axis}}{where}", "command", per),
        SignalKind(f"x{{axis}}_{unit}", unit, f"position of {what}", "measured", per),
        SignalKind(f"v{{axis}}_{suffix}", speed, f"velocity of {what}", "measured", per),
        SignalKind("tau{axis}_Nm", "N·m", "actual torque of axis {axis}, motor side", "measured", per),
    )


def _load_motors(unit: str, what: str) -> tuple[SignalKind, ...]:
    per = Per.LOAD_MOTOR
    return (
        SignalKind("tau_{load_motor}_Nm", "N·m", "actual torque of the load motor, motor side", "load", per),
        SignalKind("tau_{load_motor}_cmd_Nm", "N·m", "torque command of the load motor, motor side", "load", per),
        SignalKind(f"x_{{load_motor}}_{unit}", unit, f"position of the load motor: {what}", "load", per),
    )


_TWIN: Final = (
    SignalKind("twin_age_cycles", "", "cycles since the SYNC that the twin's data are of", "twin", integer=True),
    SignalKind("twin_status", "", "status bits 2100h:3 of the twin", "twin", integer=True),
)
_BUS: Final = (
    SignalKind("bus_bits", "bit", "bits on the bus in the cycle, stuff bits included", "bus", integer=True),
    SignalKind("statusword{axis}", "", "statusword 6041h of axis {axis}", "bus", Per.AXIS, integer=True),
    SignalKind(
        "statusword_{load_motor}", "", "statusword 6041h of the load motor", "bus", Per.LOAD_MOTOR, integer=True
    ),
)

_WEB_LINE: Final = (
    *_TIME,
    *_axes("m", ", at the web", "roller {axis}: encoder times nominal radius"),
    SignalKind("strain_prev", "", "strain of the web upstream of roller 1", "boundary"),
    SignalKind("F_next_N", "N", "web tension downstream of the last roller", "boundary"),
    SignalKind("F{span}_ref_N", "N", "tension set-point", "command", Per.SPAN),
    *_load_motors("m", "encoder times nominal radius"),
    SignalKind("F{span}_sim_N", "N", "web tension simulated by the twin (virtual sensor)", "twin", Per.SPAN),
    SignalKind("E{span}_sim_Pa", "Pa", "Young's modulus estimated by the twin", "twin", Per.SPAN),
    SignalKind("E{span}_sd_Pa", "Pa", "standard deviation of the estimate, as the twin states it", "twin", Per.SPAN),
    SignalKind("tau{next}_sim_Nm", "N·m", "torque of axis {next} simulated by the twin, motor side", "twin", Per.SPAN),
    SignalKind(
        "tau{next}_residual_Nm",
        "N·m",
        "torque of axis {next}, measured minus simulated, as the twin reports it",
        "twin",
        Per.SPAN,
    ),
    *_TWIN,
    SignalKind(
        "loop{span}_closed",
        "",
        "1 while the tension loop is closed on the simulated tension",
        "command",
        Per.SPAN,
        integer=True,
    ),
    SignalKind("E{span}_true_Pa", "Pa", "Young's modulus of the imitated web", "truth", Per.SPAN),
    SignalKind("F{span}_true_N", "N", "tension of the imitated web", "truth", Per.SPAN),
    SignalKind("strain{span}_true", "", "strain of the imitated web", "truth", Per.SPAN),
    *_BUS,
)

_SERVO_AXIS: Final = (
    *_TIME,
    *_axes("rad", ", at the motor shaft", "the motor shaft of axis {axis}"),
    *_load_motors("rad", "its shaft"),
    SignalKind("J_sim_kg_m2", "kg·m²", "inertia of the shaft estimated by the twin", "twin"),
    SignalKind("J_sd_kg_m2", "kg·m²", "standard deviation of the inertia, as the twin states it", "twin"),
    SignalKind("coulomb_sim_Nm", "N·m", "dry friction of the shaft estimated by the twin", "twin"),
    SignalKind("tau{axis}_sim_Nm", "N·m", "torque of axis {axis} simulated by the twin, motor side", "twin", Per.AXIS),
    SignalKind(
        "tau{axis}_residual_Nm",
        "N·m",
        "torque of axis {axis}, measured minus simulated, as the twin reports it",
        "twin",
        Per.AXIS,
    ),
    *_TWIN,
    SignalKind("J_true_kg_m2", "kg·m²", "inertia of the imitated shaft", "truth"),
    SignalKind("coulomb_true_Nm", "N·m", "dry friction of the imitated shaft", "truth"),
    *_BUS,
)

#: What each kind of machine declares, in recording order.
DECLARATIONS: Final[dict[str, tuple[SignalKind, ...]]] = {"web_line": _WEB_LINE, "servo_axis": _SERVO_AXIS}
#: Axes and spans of the smallest machine of each kind.
_SMALLEST: Final = {"web_line": (2, 1), "servo_axis": (1, 0)}


def signals_of(kind: str, axes: int, load_motors: Sequence[str], spans: int) -> tuple[Signal, ...]:
    """The signals of a bench in recording order: of the machine's `axes` and `spans`, and of its load motors by name.

    Raises KeyError for an unknown kind of machine.
    """
    return tuple(signal for each in DECLARATIONS[kind] for signal in _instances(each, axes, load_motors, spans))


def _instances(kind: SignalKind, axes: int, load_motors: Sequence[str], spans: int) -> Iterator[Signal]:
    if kind.per is Per.BENCH:
        yield kind.of("")
    elif kind.per is Per.LOAD_MOTOR:
        yield from map(kind.of, load_motors)
    else:
        for number in range(1, (axes if kind.per is Per.AXIS else spans) + 1):
            yield kind.of(str(number), number="" if kind.per is Per.SPAN and spans == 1 else str(number))


@cache
def find_signal(name: str) -> Signal | None:
    """What is declared under a name, whatever the bench; None for a name that no kind of part has."""
    found = [kind for kinds in DECLARATIONS.values() for kind in kinds if _pattern(kind).fullmatch(name)]
    # `tau_load_cmd_Nm` is the command of a motor `load` before it is the torque of a motor `load_cmd`.
    found.sort(key=lambda kind: len(kind.name), reverse=True)
    return _named(found[0], name) if found else None


_PATTERNS: Final = {"axis": r"[1-9]\d*", "next": r"[1-9]\d*", "span": r"(?:[1-9]\d*)?", "load_motor": r"[A-Za-z]\w*?"}


@cache
def _pattern(kind: SignalKind) -> re.Pattern[str]:
    return re.compile(kind.name.format_map({key: f"(?P<{key}>{pattern})" for key, pattern in _PATTERNS.items()}))


def _named(kind: SignalKind, name: str) -> Signal:
    found = _pattern(kind).fullmatch(name)
    parts = {} if found is None else found.groupdict()
    part = parts.get(str(kind.per)) or (str(int(parts["next"]) - 1) if parts.get("next") else "1")
    return Signal(name, kind.unit, kind.of(part).description, kind.group, kind.integer)


def example_names() -> list[str]:
    """The names that the smallest bench of each kind of machine has: what a misspelt name is compared with."""
    smallest = (signals_of(kind, axes, ["load"], spans) for kind, (axes, spans) in _SMALLEST.items())
    return list(dict.fromkeys(signal.name for signals in smallest for signal in signals))


def kind_of(names: Iterable[str]) -> str:
    """Which kind of machine has most of the signals with these names, the first of them where several have."""
    given = list(names)
    return max(DECLARATIONS, key=lambda kind: sum(_has(kind, name) for name in given))


@cache
def _has(kind: str, name: str) -> bool:
    return any(_pattern(each).fullmatch(name) for each in DECLARATIONS[kind])


_UNIT_SUFFIXES: Final = (
    ("_kg_m2", "kg·m²"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_Nm", "N·m"),
    ("_Pa", "Pa"),
    ("_N", "N"),
    ("_m", "m"),
    ("_s", "s"),
)


def unit_of(name: str) -> str:
    """SI unit of a channel: as declared, or, for a channel that no part has, from the suffix of its name."""
    signal = find_signal(name)
    if signal is not None:
        return signal.unit
    return next((unit for suffix, unit in _UNIT_SUFFIXES if name.endswith(suffix)), "")
