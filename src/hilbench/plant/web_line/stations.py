"""Stations of a web line besides driven rollers: idlers, dancers, accumulators, reels; rollers and carriages of a line.

The web turns half round at every roller of a dancer or accumulator, so that its strands are parallel to the carriage's
travel. Every value is at the web or, of a carriage, along its travel.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, FiniteFloat, model_validator

from hilbench.block import Block
from hilbench.plant.parameters import NotNegative, Positive

#: Expected line where other stations are not supported.
ONLY_DRIVEN = "driven rollers alone: idlers, dancers, accumulators and reels are not known here yet"

StationName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class DrivenRoller(Block):
    """Next one of the driven rollers, defined under `rollers:`, `motors:` and `drives:`."""

    type: Literal["roller"] = Field(description="one that a motor drives")


class Reel(Block):
    """Driven reel at an end of the line: defined, too, under `rollers:` (its radius at the start, which its motion
    refers to, and its inertia without the web on it), `motors:` and `drives:`."""

    type: Literal["unwinder", "rewinder"] = Field(description="the first, or the last, of the line")
    name: StationName | None = Field(default=None, description="its type unless given")
    core_radius_m: Positive = Field(description="of the empty reel")
    density_kg_m3: NotNegative = Field(description="of the web that is wound on it")


class IdlerRollers(Block):
    """Roller without a motor; of an accumulator each of them."""

    radius_m: Annotated[FiniteFloat, Field(ge=1e-4, le=100.0)] = Field(description="of a roller without a motor")
    inertia_kg_m2: Positive = Field(description="of such a roller about its shaft")
    roller_coulomb_friction_N: NotNegative = Field(default=0.0, description="dry friction of such a roller, at the web")
    roller_viscous_friction_N_s_per_m: NotNegative = Field(
        default=0.0, description="friction of such a roller in proportion to the speed, at the web"
    )


class Idler(IdlerRollers):
    """Roller turned by the web."""

    type: Literal["idler"] = Field(description="one that the web turns")
    name: StationName = Field(description="in the names of its quantities")


class CarriageStation(IdlerRollers):
    """Carriage with rollers, whose motion lengthens its strands of web."""

    name: StationName = Field(description="in the names of its quantities")
    mass_kg: Positive = Field(description="that moves, with the rollers; of an arm J/arm²")
    force_N: FiniteFloat = Field(
        default=0.0, description="that pushes the way which lengthens the web: pneumatics, weight; can be changed"
    )
    spring_N_per_m: NotNegative = Field(default=0.0, description="of a spring on the carriage")
    spring_rest_m: FiniteFloat = Field(default=0.0, description="position at which the spring pushes nothing")
    viscous_friction_N_s_per_m: NotNegative = Field(default=0.0, description="of the guide or cylinder")
    coulomb_friction_N: NotNegative = Field(default=0.0, description="dry, of the guide or cylinder: it may stick")
    position_m: FiniteFloat = Field(
        default=0.0, description="at the start; at 0 the strands are as long as `span_length_m` says"
    )
    lower_stop_m: FiniteFloat | None = Field(default=None, description="least position; null: no stop there")
    upper_stop_m: FiniteFloat | None = Field(default=None, description="greatest position; null: no stop there")

    @model_validator(mode="after")
    def _between_its_stops(self) -> Self:
        lowest = -float("inf") if self.lower_stop_m is None else self.lower_stop_m
        highest = float("inf") if self.upper_stop_m is None else self.upper_stop_m
        if not lowest < highest or not lowest <= self.position_m <= highest:
            raise ValueError(f"position_m between lower_stop_m and upper_stop_m, {self.position_m:g} is not")
        return self

    @property
    def strand_count(self) -> int:
        """Number of strands of web lengthened by its travel; there is a roller between any two of them."""
        return 2

    @property
    def arm_length_m(self) -> float:
        """Arm length of a carriage on an arm; 0 on a guide."""
        return 0.0

    def strand_gain(self, position_m: float) -> float:
        """Growth of a strand per travel at this position."""
        return cos(position_m / self.arm_length_m) if self.arm_length_m else 1.0

    def held_by_N(self, tension_N: float, position_m: float) -> float:
        """Force that holds it at this position against its spring and strands of this tension."""
        spring_N = self.spring_N_per_m * (position_m - self.spring_rest_m)
        return self.strand_count * self.strand_gain(position_m) * tension_N + spring_N

    @property
    def kept_tension_N(self) -> float:
        """Tension of its strands kept by its force and spring at its start position."""
        spring_N, per_N = self.held_by_N(0.0, self.position_m), self.held_by_N(1.0, self.position_m)
        return (self.force_N - spring_N) / (per_N - spring_N)


class Dancer(CarriageStation):
    """Dancer: one roller on a carriage or an arm between two strands."""

    type: Literal["dancer"] = Field(description="a roller on a carriage or arm")
    arm_m: Positive | None = Field(
        default=None,
        description="length of the arm, square to the strands at position 0; positions are along its arc. null: a "
        "carriage on a straight guide",
    )

    @property
    def arm_length_m(self) -> float:
        """Arm length; 0 without one."""
        return self.arm_m or 0.0


class Accumulator(CarriageStation):
    """Accumulator: a carriage over several strands, with rollers alternating between carriage and frame."""

    type: Literal["accumulator"] = Field(description="a carriage over several strands")
    strands: int = Field(ge=2, le=64, description="of web; there are as many rollers less one")

    @property
    def strand_count(self) -> int:
        """Configured number of strands."""
        return self.strands


Station = Annotated[DrivenRoller | Reel | Idler | Dancer | Accumulator, Discriminator("type")]


@dataclass(frozen=True, slots=True)
class LineRoller:
    """Roller that the web runs over, in its direction."""

    name: str  #: in names of quantities; of a driven one its number
    axis: int | None  #: number of the driven axis, from 1; None: it has no motor
    station: Station | None


@dataclass(frozen=True, slots=True)
class LineCarriage:
    """Carriage, and the spans lengthened by its travel, from 1."""

    station: Dancer | Accumulator
    first_span: int
    last_span: int


def rollers_of(stations: Sequence[Station]) -> tuple[LineRoller, ...]:
    """All rollers of a line, including those on carriages."""
    found: list[LineRoller] = []
    axis = 0
    for station in stations:
        if isinstance(station, DrivenRoller | Reel):
            axis += 1
            found.append(LineRoller(str(axis), axis, station))
        elif isinstance(station, Idler):
            found.append(LineRoller(station.name, None, station))
        else:
            several = station.strand_count > 2
            for number in range(1, station.strand_count):
                name = f"{station.name}_roller{number if several else ''}"
                found.append(LineRoller(name, None, station))
    return tuple(found)


def carriages_of(stations: Sequence[Station]) -> tuple[LineCarriage, ...]:
    """Carriages of a line with the spans at their rollers."""
    found, rollers = [], 0
    for station in stations:
        if isinstance(station, Dancer | Accumulator):
            found.append(LineCarriage(station, rollers, rollers + station.strand_count - 1))
            rollers += station.strand_count - 1
        else:
            rollers += 1
    return tuple(found)


def stations_problem(stations: Sequence[Station]) -> str | None:
    """Reason why a web can't run over these stations, in one line, or None."""
    last = len(stations) - 1
    names: set[str] = set()
    for number, station in enumerate(stations):
        place = f"station {number + 1}"
        name = reel_name(station) if isinstance(station, Reel) else getattr(station, "name", None)
        if name in names:
            return f"{place}: names that differ, there are two named {name}"
        names |= {name} if name else set()
        if isinstance(station, Reel) and number != (0 if station.type == "unwinder" else last):
            return f"{place}: {'an unwinder first' if station.type == 'unwinder' else 'a rewinder last'} in the line"
        if isinstance(station, CarriageStation) and number in (0, last):
            return f"{place}: the {station.type} between rollers"
        if isinstance(station, CarriageStation) and isinstance(stations[number - 1], CarriageStation):
            return f"{place}: a roller before the {station.type}, where its strands begin"
    if not any(isinstance(station, DrivenRoller | Reel) for station in stations):
        return "at least one driven roller"
    return None


def force_input(name: str) -> str:
    """Name of the input of a plant that is the force on a station's carriage."""
    return f"force_{name}_N"


def reel_name(reel: Reel) -> str:
    """Name of a reel in its quantities."""
    return reel.name or reel.type


def station_name(station: Station | None) -> str | None:
    """Name of a station in its quantities and effects; None of a driven roller, which has a number."""
    if isinstance(station, Reel):
        return reel_name(station)
    return None if station is None or isinstance(station, DrivenRoller) else station.name


def types_by_name(stations: Sequence[Station] | None) -> dict[str, str]:
    """Types of the named stations."""
    return {name: each.type for each in stations or () if (name := station_name(each)) is not None}
