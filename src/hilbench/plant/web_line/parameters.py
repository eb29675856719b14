"""Model file of a web line (also the ``machine:`` block of a bench config), and quantities derived from it.

All quantities SI, units in the key names. A value that may differ from roller to roller (or span to span) is one number
for all of them or a list. Without ``web:`` the model is a lone axis.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import pi
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import BaseModel, Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from hilbench import strict_yaml
from hilbench.block import Block
from hilbench.errors import UnusableInputError
from hilbench.plant.effect import Effect, MachineKind, Section
from hilbench.plant.effects import find_effect
from hilbench.plant.parameters import (
    NOTHING_IS_NO_EFFECT,
    DriveParameters,
    EffectEntry,
    GearRatio,
    NotNegative,
    per_item,
)
from hilbench.plant.web_line.stations import (
    LineCarriage,
    LineRoller,
    Reel,
    Station,
    carriages_of,
    rollers_of,
    stations_problem,
    types_by_name,
)

#: Range of meaningful Young's moduli: from the softest gel to beyond diamond.
LEAST_MODULUS_Pa, LARGEST_MODULUS_Pa = 1e3, 1e13
Length = Annotated[FiniteFloat, Field(ge=1e-3, le=1e4)]
Radius = Annotated[FiniteFloat, Field(ge=1e-4, le=100.0)]
Width = Annotated[FiniteFloat, Field(ge=1e-3, le=100.0)]
Thickness = Annotated[FiniteFloat, Field(ge=1e-7, le=0.1)]
Modulus = Annotated[FiniteFloat, Field(ge=LEAST_MODULUS_Pa, le=LARGEST_MODULUS_Pa)]


class WebParameters(Block):
    """Elastic web; each value is one for every span or a list of them, in the direction of the web."""

    youngs_modulus_Pa: Modulus | Annotated[list[Modulus], Field(min_length=1)] = Field(
        description="E along the run of the web; a list where it differs from span to span (warmth, moisture)"
    )
    width_m: Width | Annotated[list[Width], Field(min_length=1)] = Field(description="across the machine")
    thickness_m: Thickness | Annotated[list[Thickness], Field(min_length=1)] = Field(
        description="with the width: the section S, tension = E·S·strain"
    )
    span_length_m: Length | Annotated[list[Length], Field(min_length=1)] = Field(
        description="free web between two rollers"
    )


class RollerParameters(Block):
    """Rollers and their gears (motor turns `gear_ratio` times as fast)."""

    radius_m: Radius | list[Radius] = Field(description="nominal radius")
    inertia_kg_m2: NotNegative | list[NotNegative] = Field(description="of a roller about its own shaft")
    gear_ratio: GearRatio | list[GearRatio] = Field(
        default=1.0, description="turns of the motor per turn of the roller"
    )


class MotorParameters(Block):
    """Motors of the rollers, at the motor shaft."""

    inertia_kg_m2: NotNegative | list[NotNegative] = Field(default=0.0, description="of a motor, at its shaft")


class BoundaryParameters(Block):
    """Boundary conditions by the neighbouring sections. Without `upstream_strain` it is upstream_tension_N/(E·S) by E·S
    of span 1, without `downstream_strain` downstream_tension_N/(E·S) by that of the last span."""

    upstream_tension_N: NotNegative = Field(default=0.0, description="before the first roller")
    downstream_tension_N: NotNegative = Field(default=0.0, description="behind the last roller")
    upstream_strain: Annotated[FiniteFloat, Field(gt=-0.5, lt=1.0)] | None = Field(
        default=None, description="of the web that enters; stays what it is when E steps"
    )
    downstream_strain: Annotated[FiniteFloat, Field(gt=-0.5, lt=1.0)] | None = Field(
        default=None,
        description="of the web behind the last roller at downstream_tension_N, which enters in reverse; stays what it "
        "is when E steps",
    )


def _count(name: str, value: object, expected: int) -> None:
    if isinstance(value, list) and len(value) != expected:
        raise ValueError(f"{name} has {len(value)} values, expected one or {expected}")


class ModelParameters(Block):
    """One model: web, rollers, motors, drives, boundary and effects.

    Immutable; `model_copy(update=…)` varies it.
    """

    #: Of its axes' positions; speeds are per second.
    position_unit: ClassVar[Literal["m", "rad"]] = "m"
    #: By whose effects, signals and metrics it goes.
    machine_kind: ClassVar[MachineKind] = MachineKind.WEB_LINE

    kind: Literal["web_line"] = Field(default="web_line", description="what machine this is")
    web: WebParameters | None = None
    rollers: RollerParameters
    motors: MotorParameters = MotorParameters()
    drives: DriveParameters | None = None
    boundary: BoundaryParameters = BoundaryParameters()
    stations: tuple[Station, ...] | None = Field(
        default=None,
        description="all that the web runs over, in its direction, where that is more than driven rollers; a span is "
        "between any two rollers that follow each other",
    )
    web_load: bool | list[bool] = Field(
        default=True, description="whether the web's tensions load the roller; one value or one per roller"
    )
    effects: Annotated[tuple[EffectEntry, ...], NOTHING_IS_NO_EFFECT] = Field(
        default=(), description="what else the model has, of the vocabulary of effects"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        axes = self.axis_count
        for part in (self.rollers, self.motors, self.drives):
            for name, value in part or ():
                _count(name, value, axes)
        _count("web_load", self.web_load, axes)
        if self.web is not None:
            for name, value in self.web:
                _count(name, value, self.span_count)
        self._check_stations()
        if self.web is None and (axes > 1 or self.boundary != BoundaryParameters()):
            raise ValueError("several rollers or a boundary without a web, expected 'web' or a lone axis")
        if not -0.5 < self.upstream_strain < 1.0:
            raise ValueError(
                f"upstream_tension_N of {self.boundary.upstream_tension_N:g} N strains the web that enters by "
                f"{self.upstream_strain:g}, expected less than 1 (E·S is {self.stiffness_N(1):g} N)"
            )
        for axis in range(1, axes + 1):
            if self.mass_kg(axis) <= 0.0:
                raise ValueError(f"axis {axis} has no inertia, expected inertia of roller or motor above 0")
        return self

    @field_validator("stations")
    @classmethod
    def _stations_fit(cls, stations: tuple[Station, ...] | None) -> tuple[Station, ...] | None:
        problem = None if stations is None else stations_problem(stations)
        if problem:
            raise ValueError(problem)
        return stations

    def _check_stations(self) -> None:
        if self.stations is not None and self.web is None:
            raise ValueError("stations without a web, expected 'web'")
        for roller in self.line_rollers:
            if isinstance(roller.station, Reel) and roller.axis is not None:
                radius_m, core_m = self.radius_m(roller.axis), roller.station.core_radius_m
                if core_m > radius_m:
                    raise ValueError(
                        f"core_radius_m of {core_m:g}, expected at most its radius at the start, {radius_m:g}"
                    )

    @field_validator("effects")
    @classmethod
    def _effects_fit(cls, entries: tuple[EffectEntry, ...], info: ValidationInfo) -> tuple[EffectEntry, ...]:
        if "rollers" not in info.data:
            return entries  # the rollers' own error is the one to report
        of = {name: info.data.get(name) for name in ("stations", "web", "rollers", "motors", "drives")}
        axes, spans = _axis_count(**of), _span_count(**of)
        used: Counter[tuple[str, Section | None]] = Counter()
        for position, entry in enumerate(entries):
            effect = find_effect(entry.effect)
            problem = effect.axis_problem(entry.axis, axes if effect.per_axis else None)
            problem = problem or effect.section_problem(entry.section, spans)
            problem = problem or effect.station_problem(entry.section, types_by_name(of["stations"]))
            if problem is None and info.data.get("web") is None and not effect.per_axis:
                problem = f"effect '{effect.id}' in a model without a web"
            places = places_of(effect, entry.axis, entry.section, spans)
            used.update((effect.id, place) for place in places)
            if problem is None and any(used[effect.id, place] > effect.slots for place in places):
                problem = f"effect '{effect.id}' is given more than {effect.slots} times at one place"
            if problem:
                raise ValueError(f"entry {position + 1}: {problem}")
        return entries

    @property
    def axis_count(self) -> int:
        """Number N of driven rollers in the line (1 without a web)."""
        return _axis_count(self.stations, self.web, self.rollers, self.motors, self.drives)

    @property
    def span_count(self) -> int:
        """Number of free spans between successive rollers."""
        return _span_count(self.stations, self.web, self.rollers, self.motors, self.drives)

    @property
    def line_rollers(self) -> tuple[LineRoller, ...]:
        """All rollers that the web runs over, in its direction."""
        if self.stations is None:
            return tuple(LineRoller(str(axis), axis, None) for axis in range(1, self.axis_count + 1))
        return rollers_of(self.stations)

    @property
    def carriages(self) -> tuple[LineCarriage, ...]:
        """Carriages of dancers and accumulators, in the direction of the web."""
        return () if self.stations is None else carriages_of(self.stations)

    @property
    def station_types(self) -> dict[str, str]:
        """Types of the named stations."""
        return types_by_name(self.stations)

    def radius_m(self, axis: int) -> float:
        """Nominal radius of the roller of `axis` (counted from 1)."""
        return per_item(self.rollers.radius_m, axis)

    def gear_ratio(self, axis: int) -> float:
        """Motor speed over roller speed."""
        return per_item(self.rollers.gear_ratio, axis)

    def motor_rad_per_m(self, axis: int) -> float:
        """Motor angle per metre of web, i/r; also web force per motor torque."""
        return self.gear_ratio(axis) / self.radius_m(axis)

    def velocity_loop_per_s(self, axis: int) -> float:
        """Bandwidth of the velocity loop of an axis: kp/J at the motor, 0 without drives."""
        kp = per_item(self.drives.velocity_kp_Nm_s_per_rad, axis) if self.drives else 0.0
        return kp * self.motor_rad_per_m(axis) ** 2 / self.mass_kg(axis)

    def motor_rad_per_unit(self, axis: int) -> float:
        """Motor angle per unit of the axis' position: `motor_rad_per_m`."""
        return self.motor_rad_per_m(axis)

    def roller_mass_kg(self, axis: int) -> float:
        """J_roller/r²: the roller alone, at the web."""
        return per_item(self.rollers.inertia_kg_m2, axis) / self.radius_m(axis) ** 2

    def wound_inertia_kg_m2(self, axis: int) -> float:
        """Inertia of the web on a reel at the start, about its shaft; 0 of another roller."""
        if self.stations is None:
            return 0.0
        roller = next(roller for roller in self.line_rollers if roller.axis == axis)
        if not isinstance(roller.station, Reel):
            return 0.0
        span = 1 if roller.station.type == "unwinder" else self.span_count
        ring_m4 = self.radius_m(axis) ** 4 - roller.station.core_radius_m**4
        return 0.5 * pi * roller.station.density_kg_m3 * per_item(self.required_web.width_m, span) * ring_m4

    def motor_mass_kg(self, axis: int) -> float:
        """Mass i²·J_motor/r² of the motor alone, at the web."""
        return per_item(self.motors.inertia_kg_m2, axis) * self.motor_rad_per_m(axis) ** 2

    def mass_kg(self, axis: int) -> float:
        """Mass m = (J_roller + i²·J_motor)/r² (design section 5); of a reel with the web on it at the start."""
        wound_kg = self.wound_inertia_kg_m2(axis) / self.radius_m(axis) ** 2
        return self.roller_mass_kg(axis) + self.motor_mass_kg(axis) + wound_kg

    def drive_stiffness_N_per_m(self, axis: int) -> float:
        """Stiffness ki·(i/r)² of the integral part of the velocity loop at the roller; inf without one."""
        ki = per_item(self.drives.velocity_ki_Nm_per_rad, axis) if self.drives else 0.0
        return ki * self.motor_rad_per_m(axis) ** 2 if ki > 0.0 else float("inf")

    def carries_web_load(self, axis: int) -> bool:
        """True if the tensions act on the roller of `axis`."""
        return self.web is not None and per_item(self.web_load, axis)

    def span_length_m(self, span: int) -> float:
        """Nominal length of a span (counted from 1). Raises ValueError without a web."""
        return per_item(self.required_web.span_length_m, span)

    def youngs_modulus_Pa(self, span: int) -> float:
        """E of the web in a span (counted from 1), without effects. Raises ValueError without a web."""
        return per_item(self.required_web.youngs_modulus_Pa, span)

    def section_m2(self, span: int) -> float:
        """Cross-section S of the web in a span (counted from 1). Raises ValueError without a web."""
        return per_item(self.required_web.width_m, span) * per_item(self.required_web.thickness_m, span)

    def stiffness_N(self, span: int) -> float:
        """E·S in a span (counted from 1): tension per strain, by the model file. Raises ValueError without a web."""
        return self.youngs_modulus_Pa(span) * self.section_m2(span)

    @property
    def required_web(self) -> WebParameters:
        """Parameters of the web. Raises ValueError when the model is a lone axis."""
        if self.web is None:
            raise ValueError("the model has no web, expected 'web' in the model file")
        return self.web

    @property
    def upstream_strain(self) -> float:
        """Strain of the web that enters; independent of changes of E (0 without a web)."""
        if self.boundary.upstream_strain is not None:
            return self.boundary.upstream_strain
        return self.boundary.upstream_tension_N / self.stiffness_N(1) if self.web else 0.0

    @property
    def downstream_strain(self) -> float:
        """Strain of the web after the last roller, which enters in reverse; independent of changes of E (0 without a
        web)."""
        if self.boundary.downstream_strain is not None:
            return self.boundary.downstream_strain
        return self.boundary.downstream_tension_N / self.stiffness_N(self.span_count) if self.web else 0.0

    @property
    def upstream_stiffness_N(self) -> float:
        """Upstream tension per upstream strain: F_prev by a recorded strain."""
        strain, tension = self.upstream_strain, self.boundary.upstream_tension_N
        if tension > 0.0 and strain > 0.0:
            return tension / strain
        return self.stiffness_N(1) if self.web else 0.0

    @property
    def downstream_stiffness_N(self) -> float:
        """Downstream tension per downstream strain: strain by a recorded F_next."""
        strain, tension = self.downstream_strain, self.boundary.downstream_tension_N
        if tension > 0.0 and strain > 0.0:
            return tension / strain
        return self.stiffness_N(self.span_count) if self.web else 0.0

    def with_effects(self, *entries: EffectEntry) -> ModelParameters:
        """Model with further effects, validated. Raises pydantic.ValidationError."""
        data = self.model_dump()
        data["effects"] = [*data["effects"], *(entry.model_dump() for entry in entries)]
        return ModelParameters.model_validate(data)


def places_of(effect: Effect, axis: int | None, span: Section | None, spans: int) -> tuple[Section | None, ...]:
    """Locations of an effect in a line with `spans`: its axis, its spans, its station, or (None,) for all of the line.

    A per-span effect without a span is in all of them.
    """
    if effect.per_axis:
        return (axis,)
    if effect.per_section:
        return tuple(range(1, spans + 1)) if span is None else (span,)
    return (span,) if effect.stations else (None,)


def _axis_count(
    stations: tuple[Station, ...] | None,
    web: WebParameters | None,
    rollers: BaseModel | None,
    motors: BaseModel | None,
    drives: BaseModel | None,
) -> int:
    if stations is not None:
        return sum(roller.axis is not None for roller in rollers_of(stations))
    parts = (rollers, motors, drives)
    lengths = [len(value) for part in parts if part for value in vars(part).values() if isinstance(value, list)]
    lengths += [len(value) + 1 for value in (vars(web).values() if web else ()) if isinstance(value, list)]
    return max(lengths, default=1 if web is None else 2)


def _span_count(
    stations: tuple[Station, ...] | None,
    web: WebParameters | None,
    rollers: BaseModel | None,
    motors: BaseModel | None,
    drives: BaseModel | None,
) -> int:
    count = _axis_count(None, web, rollers, motors, drives) if stations is None else len(rollers_of(stations))
    return count - 1


def load_model(path: str | Path) -> ModelParameters:
    """Read a model file. Raises UnusableInputError (file, line, key, found, expected)."""
    document = strict_yaml.load(Path(path))
    if not isinstance(document.data, Mapping):
        raise UnusableInputError(document.place(), "no mapping, expected a model file with the key 'rollers'")
    return strict_yaml.validate(document, ModelParameters)
