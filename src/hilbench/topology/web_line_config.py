"""Bench config of a web line, without its machine: emulated web, tension and position loops, estimation."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BeforeValidator, Discriminator, Field, FiniteFloat, PositiveFloat, Tag

from hilbench.block import Block
from hilbench.estimation.web_line.config import EstimationConfig, InputConfig
from hilbench.plant.web_line.parameters import Length, ModelParameters, Modulus
from hilbench.plant.web_line.stations import Accumulator, Dancer, Idler, Reel, StationName, reel_name


class LoadWebConfig(Block):
    """Deviations of the emulated web from the model; what is not given is as in `machine:`."""

    youngs_modulus_Pa: Modulus | list[Modulus] | None = Field(
        default=None, description="Young's modulus E of the emulated web: one, or a list of the spans'"
    )
    span_length_m: Length | list[Length] | None = Field(default=None, description="free web between two driven rollers")

    def misfits(self, count: int) -> Iterator[str]:
        """Why it can't be the web of a line of so many spans."""
        for name, of_spans in self:
            if isinstance(of_spans, list) and len(of_spans) != count:
                yield f"'web.{name}' as one number or {count}"


ProbingMode = Literal["off", "ask", "on"]


class ProbingConfig(Block):
    """Small known changes of the tension set-point that separate E from friction and from an offset of the torque."""

    mode: ProbingMode = Field(
        default="off",
        description="on: made when the deviation of E is wide; ask: only when an operator allows it; off: never",
    )
    amplitude_pct: float = Field(default=2.0, gt=0, le=2.0, description="of the set-point, either way")
    period_s: float = Field(default=1.25, ge=0.2, le=60, description="of going up and down")
    duration_s: float = Field(default=5.0, ge=1, le=60, description="of a probe")
    deviation_pct: PositiveFloat = Field(default=0.5, description="stated deviation of E from which it is wide")
    settled_s: PositiveFloat = Field(default=2.0, description="how long the line has to be steady before a probe")
    rest_s: float = Field(default=60.0, ge=0, description="least time between two automatic probes")
    at_rest_mm: float = Field(
        default=0.0,
        ge=0,
        le=1,
        description="how far the rollers of the line may move at rest, where E and strains of the webs in it are "
        "unknown; 0: not at all; the largest of the controllers'",
    )


class TensionControlConfig(Block):
    """The tension loop: how the velocity of the axis before a span keeps its simulated tension at the set-point."""

    kind: Literal["tension"] = "tension"
    span: int = Field(default=1, ge=1, description="number of the span whose tension is kept")
    set_point_N: PositiveFloat = Field(default=80.0, description="of the simulated tension, the sensor of the loop")
    bandwidth_rad_per_s: PositiveFloat = Field(default=6.0, description="of the closed tension loop")
    twin_age_limit_cycles: int = Field(
        default=10, ge=0, description="age of the twin's data up to which the loop stays closed on them"
    )
    twin_deviation_limit_pct: PositiveFloat = Field(
        default=30.0, description="stated deviation of E up to which the loop stays closed on the twin"
    )
    correction_limit_m_s: PositiveFloat = Field(
        default=0.02, description="largest |v1 - v2| the controller asks for, without the damping"
    )
    swing_damping_ratio: float = Field(
        default=1.3,
        ge=0.0,
        le=2.0,
        description="damping ratio that axis 1 gives the oscillation of roller 2 on the web; 0: none",
    )
    feed_forward: Literal["none", "twin"] = Field(
        default="none",
        description="twin: the ratio of speeds from its E and the strain that enters the span, and the rollers' "
        "torques at ramps and steps of set-points, ahead of the controller, so that neighbours are not disturbed",
    )
    set_point_rise_s: float = Field(
        default=0.4, ge=0.05, le=60, description="with feed_forward: rise time of a stepped set-point"
    )
    probing: ProbingMode | ProbingConfig = Field(
        default="off", description="small known changes of the tension; a word alone is the mode"
    )

    @property
    def probes(self) -> ProbingConfig:
        """Config of the tension probing."""
        return ProbingConfig(mode=self.probing) if isinstance(self.probing, str) else self.probing


class CarriageForceConfig(Block):
    """The force on the carriage of a dancer or accumulator, fed forward to a valve that sets the pressure: what keeps
    the tension, with what carriage and rollers need to speed up, and their friction, by the machine's model."""

    set_point_N: PositiveFloat | None = Field(
        default=None,
        description="of the tension behind the carriage at an even speed; what the machine's force keeps unless given",
    )
    behind_takes: float = Field(
        default=0.5,
        ge=0,
        le=1,
        description="share of what the tensions at both ends come to differ by, as rollers between speed up, that the "
        "one behind has: 0 where it is to stay, 1 where that before is",
    )
    limit_N: PositiveFloat | None = Field(
        default=None, description="most force of the cylinder, which never pulls; null: none"
    )

    def tension_N(self, station: Dancer | Accumulator) -> float:
        """The set-point, of this carriage."""
        return station.kept_tension_N if self.set_point_N is None else self.set_point_N


class PositionControlConfig(Block):
    """The position loop of a dancer or accumulator: how the driven roller or reel before it keeps its carriage."""

    kind: Literal["position"] = Field(description="of a dancer or accumulator; without a kind: of a tension")
    station: StationName = Field(description="the dancer or accumulator, one with a sensor (load: measured)")
    set_point_m: FiniteFloat | None = Field(
        default=None, description="where its carriage is to stand; where it stands at the start unless given"
    )
    bandwidth_rad_per_s: PositiveFloat = Field(default=2.0, le=100.0, description="of the closed position loop")
    correction_limit_m_s: PositiveFloat = Field(
        default=0.2,
        description="most by which the speed before the carriage differs from that behind it, as an accumulator is "
        "filled again; it is come to within half of the loop's time constant",
    )
    feed_ramp_s: PositiveFloat = Field(
        default=2.0,
        le=600.0,
        description="time in which the axis before it comes to a stand, or to speed again, with a bounded jerk, when "
        "its feed is switched off or on (position_control.NAME.feed: a reel change)",
    )
    force: CarriageForceConfig | None = Field(
        default=None, description="sent ahead to the carriage's actuator; null: the machine's force stays"
    )


class ReelControlConfig(Block):
    """The tension loop of a reel in torque mode (cyclic synchronous torque): its torque from a load cell next to it."""

    kind: Literal["reel"] = Field(description="of a reel in torque mode; without a kind: of a tension, by a speed")
    reel: StationName = Field(description="the unwinder or rewinder, whose drive gets torque set points")
    load_cell: StationName = Field(description="the adjacent idler with a tension sensor (load: measured)")
    set_point_N: PositiveFloat = Field(default=80.0, description="of the tension at the reel")
    gain: float = Field(default=0.0, ge=0, le=100, description="of the controller, N of the reel's pull per N")
    rate_per_s: float = Field(default=2.0, ge=0, le=1e3, description="of its integral, N of the reel's pull per N·s")
    derivative_s: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="of its derivative, N of the reel's pull per N/s: damps the oscillation of the reel on its web",
    )
    feed_forward: Literal["none", "twin"] = Field(
        default="none",
        description="twin: pull and acceleration by the radius that the twin has, ahead of the controller; none: the "
        "controller alone, at the radius at the start",
    )


Compensable = Literal["roller_eccentricity", "torque_ripple", "friction"]


class CompensationConfig(Block):
    """Compensation of what turns with the rollers around the spans with a tension loop, beside that loop: what the
    machine's effects know of it is fed forward, the rest is learned turn by turn; off where it does not help."""

    kind: Literal["compensate"] = Field(default="compensate", description="a list alone is that of its effects")
    effects: tuple[Compensable, ...] = Field(
        description="what: ids of the vocabulary of effects; friction: dry, viscous and Stribeck; [] is off"
    )
    limit_m_s: PositiveFloat = Field(
        default=0.01,
        description="largest velocity for each: half of what the loop may correct, which keeps the upper hand",
    )
    least_pct: PositiveFloat = Field(
        default=0.5, description="of the set-point: a smaller swing is left, its noise would be learned"
    )


def _kind_of(value: Any) -> str:
    if isinstance(value, list):
        return "compensate"
    found: str = value.get("kind", "tension") if isinstance(value, Mapping) else getattr(value, "kind", "tension")
    return found


ControllerConfig = Annotated[
    Annotated[TensionControlConfig, Tag("tension")]
    | Annotated[PositionControlConfig, Tag("position")]
    | Annotated[ReelControlConfig, Tag("reel")]
    | Annotated[
        CompensationConfig,
        BeforeValidator(
            lambda value: {"effects": value} if isinstance(value, list) else value,
            json_schema_input_type=CompensationConfig | list[Compensable],
        ),
        Tag("compensate"),
    ],
    Discriminator(
        _kind_of, custom_error_type="kind", custom_error_message="kind: tension, position, reel or compensate"
    ),
]

Control = TypeVar("Control", TensionControlConfig, PositionControlConfig, ReelControlConfig, CompensationConfig)


def loops_of(kind: type[Control], controllers: Iterable[ControllerConfig]) -> list[Control]:
    """Controllers of a kind."""
    return [each for each in controllers if isinstance(each, kind)]


def forces_ahead(controllers: Iterable[ControllerConfig]) -> dict[str, CarriageForceConfig]:
    """Forces on carriages that are sent ahead, by the name of the station."""
    return {each.station: each.force for each in loops_of(PositionControlConfig, controllers) if each.force is not None}


def reel_axes(machine: ModelParameters) -> dict[str, int]:
    """The axis of each reel, by its name."""
    return {
        reel_name(roller.station): roller.axis
        for roller in machine.line_rollers
        if isinstance(roller.station, Reel) and roller.axis is not None
    }


def span_beside_reel(machine: ModelParameters, axis: int) -> int:
    """The span, from 1, whose web is wound off, or on, the reel that is an axis."""
    return 1 if axis == 1 else machine.span_count


def controller_misfits(controllers: Collection[ControllerConfig], count: int) -> Iterator[str]:
    """Why these can't be the controllers of a line of so many spans."""
    tensions = loops_of(TensionControlConfig, controllers)
    if controllers and not tensions and not loops_of(ReelControlConfig, controllers):
        yield "at least one of a tension (kind: tension or reel)"
    yield from _each_once([control.span for control in tensions], count, "one axis can keep one tension")


def _each_once(spans: Sequence[int], count: int, why: str) -> Iterator[str]:
    for span in spans:
        if span > count:
            yield f"a span of 1 to {count}, '{span}' is none"
    if len(set(spans)) < len(spans):
        yield f"each span at most once: {why}"


def estimate_misfits(twin: EstimationConfig, machine: ModelParameters) -> Iterator[str]:
    """Reasons why a twin can't estimate what its config asks for."""
    given = [estimate.span for estimate in twin.estimate if estimate.span is not None]
    if len(twin.estimate) > len(given) and len(twin.estimate) > 1:
        yield "'estimate' with a span in every entry, or one entry without a span for all of them"
    yield from _each_once(given, machine.span_count, "E of a span is found in one way")
    if machine.stations is not None:
        return
    unknown = "'web_at_rest: unknown'" if twin.web_at_rest == "unknown" else ""
    methods = twin.by_span(machine.span_count)
    yield from filter(None, [_unestimated_misfit(unknown, methods, machine.span_count)])
    corrects_input = any(isinstance(estimate, InputConfig) for estimate in methods.values())
    if corrects_input and twin.splices:
        yield "another method than 'input' where 'splices' are looked for: it corrects no E"
    if machine.span_count < 2:
        return
    if corrects_input:
        yield "another method than 'input', which is for a line of one span"
    first = min(methods)
    unloaded = [axis for axis in range(first + 1, machine.axis_count + 1) if not machine.carries_web_load(axis)]
    if unloaded:
        yield (
            f"'estimate' at a span behind which the web loads every roller: span {first} can't be seen in "
            f"torques as long as 'machine.web_load' says that axis {unloaded[0]} carries none"
        )


def rest_misfit(
    twin: EstimationConfig, machine: ModelParameters, controllers: Iterable[ControllerConfig], measured: Collection[str]
) -> str | None:
    """Reason why the state at rest can't be identified or requested, or None; `measured`: stations with a sensor."""
    if machine.stations is not None:
        of_sections = [*(carriage.station.name for carriage in machine.carriages), *reel_axes(machine)]
        unseen = [name for name in of_sections if name not in measured]
        if twin.web_at_rest == "unknown" and unseen:
            return (
                f"'load: {{measured: [{', '.join(of_sections)}]}}' with 'web_at_rest: unknown', not without {unseen[0]}"
            )
        return None
    asked = any(control.probes.at_rest_mm for control in loops_of(TensionControlConfig, controllers))
    return _unestimated_misfit("'at_rest_mm'" if asked else "", twin.by_span(machine.span_count), machine.span_count)


def _unestimated_misfit(key: str, estimated: Collection[int], count: int) -> str | None:
    """Reason why unknown webs are not identifiable, where a key ("": none) asks for that."""
    without = [span for span in range(1, count + 1) if span not in estimated]
    if not key or not without:
        return None
    return f"'twin: {{estimate: …}}' at every span with {key}, not without span {without[0]}"


def station_names(machine: ModelParameters) -> tuple[str, ...]:
    """Names of dancers and accumulators, which have a position, then of reels, which have a radius."""
    reels = (roller.station for roller in machine.line_rollers)
    return (
        *(carriage.station.name for carriage in machine.carriages),
        *(reel_name(reel) for reel in reels if isinstance(reel, Reel)),
    )


def load_cells(machine: ModelParameters) -> tuple[str, ...]:
    """Idlers, by name, any of which may be the roller of a load cell."""
    return tuple(roller.station.name for roller in machine.line_rollers if isinstance(roller.station, Idler))
