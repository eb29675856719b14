"""Declarations of signals, and those of every kind of machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final


class Per(StrEnum):
    """Part that has a signal of its own."""

    BENCH = "bench"
    AXIS = "axis"  #: a driven axis of the machine
    LOAD_MOTOR = "load_motor"
    SPAN = "span"
    ESTIMATED = "estimated"  #: a span at which the twin estimates something
    CONTROLLED = "controlled"  #: a span whose tension a controller keeps
    SIMULATED = "simulated"  #: a span whose tension the twin reports
    CARRIAGE = "carriage"  #: of a dancer or accumulator
    REEL = "reel"
    MEASURED_CARRIAGE = "measured_carriage"  #: one with a sensor of its position
    MEASURED_REEL = "measured_reel"  #: one with a sensor of its radius
    POSITIONED_CARRIAGE = "positioned_carriage"  #: one with a loop of its position
    PUSHED_CARRIAGE = "pushed_carriage"  #: one whose force is fed forward
    TORQUED_AXIS = "torqued_axis"  #: a reel in torque mode
    CELL = "cell"  #: an idler that is a load cell
    WINDER = "winder"  #: a reel as the last axis of a line

    @property
    def placeholder(self) -> str:
        """Placeholder in the name of a declaration for the number or name of the part."""
        if self.is_of_span:
            return "span"
        of_all = self.removeprefix("measured_").removeprefix("positioned_").removeprefix("pushed_")
        return of_all.removeprefix("torqued_")

    @property
    def is_of_span(self) -> bool:
        """True if a part is counted among the spans."""
        return self in (Per.SPAN, Per.ESTIMATED, Per.CONTROLLED, Per.SIMULATED)

    @property
    def is_counted(self) -> bool:
        """True if a part has a number; others have a name, or there is one."""
        return self in (Per.AXIS, Per.TORQUED_AXIS) or self.is_of_span


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

    def of(self, part: str, *, number: str | None = None, behind: str = "") -> Signal:
        """The signal of one part; `number`: how the part is counted in a name, if not as in the description; `behind`:
        number of the axis behind it, if not the next."""
        following = behind or (str(int(part) + 1) if part.isdecimal() else "")
        in_name = part if number is None else number
        return Signal(
            self.name.format_map({self.per.placeholder: in_name, "next": following}),
            self.unit,
            self.description.format_map({self.per.placeholder: part, "next": following}),
            self.group,
            self.integer,
        )


#: Name of the time channel, the common time base of all others.
TIME: Final = "t_s"

TIME_SIGNALS: Final = (SignalKind(TIME, "s", "bus time: number of the SYNC times the cycle", "time"),)


def axes_signals(unit: str, where: str, what: str) -> tuple[SignalKind, ...]:
    """Signals of every driven axis, in the machine's unit of position; `where` and `what` complete the descriptions."""
    speed, per = f"{unit}/s", Per.AXIS
    suffix = f"{unit}_s"
    return (
        SignalKind(f"v{{axis}}_cmd_{suffix}", speed, f"velocity command of axis {{axis}}{where}", "command", per),
        SignalKind(f"x{{axis}}_{unit}", unit, f"position of {what}", "measured", per),
        SignalKind(f"v{{axis}}_{suffix}", speed, f"velocity of {what}", "measured", per),
        SignalKind("tau{axis}_Nm", "N·m", "actual torque of axis {axis}, motor side", "measured", per),
    )


def load_motor_signals(unit: str, what: str) -> tuple[SignalKind, ...]:
    per = Per.LOAD_MOTOR
    return (
        SignalKind("tau_{load_motor}_Nm", "N·m", "actual torque of the load motor, motor side", "load", per),
        SignalKind("tau_{load_motor}_cmd_Nm", "N·m", "torque command of the load motor, motor side", "load", per),
        SignalKind(f"x_{{load_motor}}_{unit}", unit, f"position of the load motor: {what}", "load", per),
    )


def estimate_signals(name: str, unit: str, what: str, of: str, per: Per) -> tuple[SignalKind, ...]:
    """An estimate of the twin, `name` with "sim" for its place, and its standard deviation."""
    deviation = f"standard deviation of {of}, as the twin states it"
    return (
        SignalKind(name, unit, what, "twin", per),
        SignalKind(name.replace("_sim_", "_sd_"), unit, deviation, "twin", per),
    )


def twin_signals(axis: str, per: Per) -> tuple[SignalKind, ...]:
    """Torques of the axes (a placeholder) that the twin shows, and its status."""
    residual = f"torque of axis {axis}, measured minus simulated, as the twin reports it"
    return (
        SignalKind(f"tau{axis}_sim_Nm", "N·m", f"torque of axis {axis} simulated by the twin, motor side", "twin", per),
        SignalKind(f"tau{axis}_residual_Nm", "N·m", residual, "twin", per),
        SignalKind("twin_age_cycles", "", "cycles since the SYNC that the twin's data are of", "twin", integer=True),
        SignalKind("twin_status", "", "status bits 2100h:3 of the twin", "twin", integer=True),
    )


BUS_SIGNALS: Final = (
    SignalKind("bus_bits", "bit", "bits on the bus in the cycle, stuff bits included", "bus", integer=True),
    SignalKind("statusword{axis}", "", "statusword 6041h of axis {axis}", "bus", Per.AXIS, integer=True),
    SignalKind(
        "statusword_{load_motor}", "", "statusword 6041h of the load motor", "bus", Per.LOAD_MOTOR, integer=True
    ),
)
