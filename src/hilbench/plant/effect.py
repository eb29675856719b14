"""Definition of an effect: a named group of parameters that a model may lack, neutral by default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import isfinite


class MachineKind(StrEnum):
    """Kinds of machine, by the `kind:` of a config's machine."""

    WEB_LINE = "web_line"  #: driven rollers with a web between them; forces in N at the web
    SERVO_AXIS = "servo_axis"  #: one shaft; torques in N·m at the shaft


class Domain(StrEnum):
    """Domain in which an effect enters the model."""

    ROLLER_RESISTANCE = "roller_resistance"  #: force against the roller's motion, at the web
    ROLLER_TORQUE = "roller_torque"  #: torque that acts on the roller, by its angle
    MOTOR_TORQUE = "motor_torque"  #: torque that acts on the shaft
    TORQUE_MEASUREMENT = "torque_measurement"  #: torque as the drive reports it
    POSITION_MEASUREMENT = "position_measurement"  #: motion as measured by the encoder, for the drive's loops as well
    DRIVE = "drive"  #: control loops of the drive
    WEB_KINEMATICS = "web_kinematics"  #: speed of the web at a roller
    ELASTICITY = "elasticity"  #: tension from strain
    BOUNDARY = "boundary"  #: what comes from the neighbouring sections
    GEOMETRY = "geometry"  #: length of the span
    INERTIA = "inertia"  #: moving mass
    GEAR = "gear"  #: between motor and roller
    STATION = "station"  #: undriven stations, and reels


class EffectPlace(StrEnum):
    """Part of a bench that can have a hidden effect, by its config key."""

    HARDWARE = "hardware"  #: in the simulated drives, shafts and gears
    LOAD = "load"  #: in the emulation by a load motor: the machine, and external forces on a roller


#: Location of an effect: number of a section between two axes, or name of a station.
Section = int | str

#: Effects at a roller: the simulated hardware can have them, and a load motor on the roller's shaft can emulate them.
AT_A_ROLLER = frozenset({Domain.ROLLER_RESISTANCE, Domain.ROLLER_TORQUE})
_DOMAINS: Mapping[EffectPlace, frozenset[Domain]] = {
    EffectPlace.HARDWARE: AT_A_ROLLER
    | {
        Domain.MOTOR_TORQUE,
        Domain.TORQUE_MEASUREMENT,
        Domain.POSITION_MEASUREMENT,
        Domain.DRIVE,
        Domain.INERTIA,
        Domain.GEAR,
    },
    EffectPlace.LOAD: AT_A_ROLLER
    | {Domain.WEB_KINEMATICS, Domain.ELASTICITY, Domain.BOUNDARY, Domain.GEOMETRY, Domain.STATION},
}
_OF_AN_AXIS = _DOMAINS[EffectPlace.HARDWARE] | {Domain.WEB_KINEMATICS}


@dataclass(frozen=True, slots=True)
class MachineSizes:
    """Usual sizes of one machine, at one of its axes; sizes of effects are shares of them."""

    force_N: float  #: at the web: its tension, or the drive's force
    speed_m_s: float  #: highest, at the web
    radius_m: float  #: of the roller
    gear_ratio: float  #: motor turns per roller turn
    strain: float  #: of the web, 1
    sample_time_s: float  #: of the drives


@dataclass(frozen=True, slots=True)
class Size:
    """Share of a machine's usual size: `share` times the machine's sizes to these powers."""

    share: float
    force: int = 0
    speed: int = 0
    radius: int = 0
    gear: int = 0
    strain: int = 0
    sample_time: int = 0

    def on(self, machine: MachineSizes) -> float:
        """Size on one machine, in the unit of its parameter."""
        return (
            self.share
            * machine.force_N**self.force
            * machine.speed_m_s**self.speed
            * machine.radius_m**self.radius
            * machine.gear_ratio**self.gear
            * machine.strain**self.strain
            * machine.sample_time_s**self.sample_time
        )


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of an effect. `unit` is as in a recording ("1" for a ratio)."""

    name: str
    unit: str
    neutral: float  #: value in a model without the effect
    lower: float  #: least value with a meaning (inclusive)
    upper: float  #: greatest value with a meaning (inclusive)
    size: Size  #: a change that shows clearly on a machine: step size and start value of a fit
    required: bool = True  #: must be given with the effect (phases need not)

    def problem(self, value: float) -> str | None:
        """Problem of a value in one line, or None."""
        if not isfinite(value) or not self.lower <= value <= self.upper:
            return f"{self.name} = {value!r} {self.unit}, expected {self.lower:g} to {self.upper:g}"
        return None


class ProbeOver(StrEnum):
    """Search variable for an effect's parameter before a fit starts from there."""

    SHARES_OF_TOP_SPEED = "shares of top speed"  #: a speed of the law: tried at some shares of the highest
    STRENGTHS = "strengths"  #: a law far from linear in its strength: tried with several
    MOTOR_ANGLE = "motor angle"  #: an order of the motor's turn: peaks of the residual's spectrum over the angle
    TIME = "time"  #: a frequency: peaks of the residual's spectrum over time
    ONSET = "onset"  #: start time of the effect: located iteratively
    ONSET_AND_DURATION = "onset and duration"  #: the time from which it grows, and for how long
    FREQUENCIES = "frequencies"  #: a frequency of the law: tried with several
    PASSAGE = "passage"  #: start and end time of the effect: where the residual is largest for a while


@dataclass(frozen=True, slots=True)
class Probe:
    """Search method for an effect that its response at one strength does not show."""

    over: ProbeOver
    parameter: str  #: what is searched for
    duration: str = ""  #: ONSET_AND_DURATION: the parameter that is the duration
    #: SHARES_OF_TOP_SPEED: the shares; STRENGTHS: in sizes of the parameter; FREQUENCIES: in Hz.
    tried: tuple[float, ...] = ()
    by_torque: bool = False  #: MOTOR_ANGLE: the residual is weighted by the torque that it grows with


@dataclass(frozen=True, slots=True)
class Lookalike:
    """Cause outside the vocabulary that an effect may be mistaken for: reported with it, never named."""

    name: str
    distinguished_by: str  #: the experiment that separates the two


@dataclass(frozen=True, slots=True)
class Rotary:
    """Differences of an effect on a rotary machine without transport: its parameters' units, at the shaft.

    It has an object index of its own, so that an object on the bus has one unit.
    """

    law: str
    parameters: tuple[Parameter, ...]
    object_index: int
    probe: Probe | None = None  #: where the one of the row is by a parameter of another name


_WEB_ONLY = frozenset({MachineKind.WEB_LINE})


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """Effect: id, law, parameters, domain, and how it is found and shown."""

    id: str
    law: str
    domain: Domain
    parameters: tuple[Parameter, ...]
    #: Its CANopen object; its parameters are the sub-indices in order, from 1. Never reused for another effect.
    object_index: int
    #: Experiment that shows it best.
    shown_by: str
    #: Parameters that make the effect vanish when all are neutral, the first one unless given; the others only shape
    #: it. Several are searched one by one, each a term of its own: a part without evidence is not named with the
    #: others.
    strength: tuple[str, ...] = ()
    #: Number of its instances at one place of a model (several ripple orders, several steps).
    slots: int = 1
    #: Axis that may be named although the effect has no choice of axis: that of its law.
    implied_axis: int | None = None
    #: True if each section between two axes (the span of a web) can have it by itself; else it is in all of them.
    per_section: bool = False
    #: Types of the stations that can have it; empty: no effect of a station.
    stations: frozenset[str] = frozenset()
    kinds: frozenset[MachineKind] = field(default=_WEB_ONLY)
    rotary: Rotary | None = None
    #: Search method; None: its response at a strength of its usual size.
    probe: Probe | None = None
    #: True if a search may drop it again where residuals are never noise alone. The simple effects are kept, and
    #: searched first: |v| is the product of v and sign(v), and a term of higher order is interpreted together with
    #: those that it consists of, the constant included (marginality, Nelder 1977).
    removable: bool = True
    #: True if it needs inertia on both sides of a gear.
    needs_gear: bool = False
    #: The effect that it becomes with zero duration.
    at_once: str | None = None
    lookalike: Lookalike | None = None
    #: True if it is no missing mechanics but a property of the bench: found, corrected for, and separated from the
    #: named effects (the drives' loops).
    nuisance: bool = False
    #: Effects not separable from it in some recordings (ids), and the experiment that separates them, where it is
    #: another than those that show the two best.
    alike: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if not self.strength:
            object.__setattr__(self, "strength", (self.parameters[0].name,))

    @property
    def per_axis(self) -> bool:
        """True if each axis can have it by itself."""
        return self.domain in _OF_AN_AXIS and not self.per_section

    def parameter(self, name: str) -> Parameter:
        """Parameter `name`. Raises KeyError."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    def problem(self, parameters: Mapping[str, float]) -> str | None:
        """Problem of a set of parameter values, in one line, or None."""
        names = [parameter.name for parameter in self.parameters]
        for name in parameters:
            if name not in names:
                return f"effect '{self.id}' has no parameter '{name}', expected {', '.join(names)}"
        for parameter in self.parameters:
            if parameter.name in parameters:
                problem = parameter.problem(parameters[parameter.name])
                if problem:
                    return f"effect '{self.id}': {problem}"
            elif parameter.required:
                return f"effect '{self.id}' lacks its parameter '{parameter.name}' ({parameter.unit})"
        return None

    def axis_problem(self, axis: int | None, axes: int | None = None) -> str | None:
        """Problem of the axis given for it (of a machine with `axes`), in one line, or None."""
        if self.per_axis and axis is None:
            return f"effect '{self.id}' lacks its axis, expected one of the axes 1, 2, ..."
        if not self.per_axis and axis not in (None, self.implied_axis):
            return f"effect '{self.id}' with axis {axis}, expected none: it is an effect of the web"
        if axis is not None and (axis < 1 or (axes is not None and axis > axes)):
            return f"effect '{self.id}' with axis {axis}, expected 1 to {axes if axes is not None else 'N'}"
        return None

    def section_problem(self, section: Section | None, sections: int | None = None) -> str | None:
        """Problem of the section given for it (of a machine with `sections`), in one line, or None."""
        if self.stations and not isinstance(section, str):
            return f"effect '{self.id}' lacks its station, expected the name of one: {', '.join(sorted(self.stations))}"
        if section is None or self.stations:
            return None
        if isinstance(section, str):
            return f"effect '{self.id}' with station {section}, expected none: it is no effect of one"
        if not self.per_section:
            return f"effect '{self.id}' with span {section}, expected none: it is no effect of one"
        if section < 1 or (sections is not None and section > sections):
            return f"effect '{self.id}' with span {section}, expected 1 to {sections if sections is not None else 'K'}"
        return None

    def station_problem(self, section: Section | None, stations: Mapping[str, str]) -> str | None:
        """Problem of the station given for it, of a machine with `stations` (type by name), in one line, or None."""
        if not self.stations or (isinstance(section, str) and stations.get(section) in self.stations):
            return None
        able = [name for name, kind in stations.items() if kind in self.stations]
        expected = f"expected {' or '.join(able)}" if able else f"expected a {' or '.join(sorted(self.stations))} there"
        return f"effect '{self.id}' of station {section}, {expected}"

    @property
    def part(self) -> str:
        """Part of a machine it can be given for, as in paths and entries; "" for effects of the whole."""
        return "axis" if self.per_axis else "span" if self.per_section else ""

    def enters(self, place: EffectPlace) -> bool:
        """True if it can be hidden at a place."""
        return self.domain in _DOMAINS[place]

    def filled(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """All parameters, with the neutral value of those not given."""
        return {p.name: float(parameters.get(p.name, p.neutral)) for p in self.parameters}

    def distinguished_from(self, other: Effect) -> str:
        """Experiment that separates it from an effect not separable in a recording."""
        for one, two in ((self, other), (other, self)):
            for effect_id, experiment in one.alike:
                if effect_id == two.id:
                    return experiment
        return self.shown_by if self.shown_by == other.shown_by else f"{self.shown_by}; {other.shown_by}"

    def is_alike(self, other: Effect) -> bool:
        """True if some recordings don't separate it from another effect."""
        return other.id in dict(self.alike) or self.id in dict(other.alike)

    def in_kind(self, kind: MachineKind) -> Effect:
        """Effect as a kind of machine has it. Raises ValueError for a kind that does not have the effect."""
        if kind not in self.kinds:
            raise ValueError(f"effect '{self.id}' of a {kind}, expected one of {', '.join(sorted(self.kinds))}")
        if kind is MachineKind.WEB_LINE or self.rotary is None:
            return self
        of = self.rotary
        return replace(
            self,
            law=of.law,
            parameters=of.parameters,
            strength=() if self.strength == (self.parameters[0].name,) else self.strength,
            object_index=of.object_index,
            probe=of.probe or self.probe,
            rotary=None,
        )
