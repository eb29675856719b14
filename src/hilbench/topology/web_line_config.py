"""What a bench config has of a web line beside its machine: the imitated web, the tension loops, what is estimated."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Literal

from pydantic import Field, PositiveFloat

from hilbench.block import Block
from hilbench.estimation.web_line.config import EstimationConfig, InputConfig
from hilbench.plant.web_line.parameters import Length, ModelParameters, Modulus
from hilbench.plant.web_line.sections import axes_before_spans
from hilbench.plant.web_line.stations import ONLY_DRIVEN, Reel, reel_name


class LoadWebConfig(Block):
    """Where the imitated web differs from the model; what is not given is as in `machine:`."""

    youngs_modulus_Pa: Modulus | list[Modulus] | None = Field(
        default=None, description="Young's modulus E of the imitated web: one, or a list of the spans'"
    )
    span_length_m: Length | list[Length] | None = Field(default=None, description="free web between two driven rollers")


ProbingMode = Literal["off", "ask", "on"]


class ProbingConfig(Block):
    """Small known changes of the tension set-point that tell E from friction and from an offset of the torque."""

    mode: ProbingMode = Field(
        default="off",
        description="on: made when the deviation of E is wide; ask: only when an operator allows it; off: never",
    )
    amplitude_pct: float = Field(default=2.0, gt=0, le=2.0, description="of the set-point, either way")
    period_s: float = Field(default=1.25, ge=0.2, le=60, description="of going up and down")
    duration_s: float = Field(default=5.0, ge=1, le=60, description="of a probe")
    deviation_pct: PositiveFloat = Field(default=0.5, description="stated deviation of E from which it is wide")
    settled_s: PositiveFloat = Field(default=2.0, description="how long the line has to be steady before a probe")
    rest_s: float = Field(default=60.0, ge=0, description="least time between two probes that nobody asked for")


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
        description="damping ratio that axis 1 gives the swing of roller 2 against the web; 0: none",
    )
    feed_forward: Literal["none", "twin"] = Field(
        default="none",
        description="twin: the ratio of speeds from its E and the strain that enters the span, and the rollers' "
        "torques at ramps and steps of set-points, ahead of the controller, so that neighbours are not disturbed",
    )
    set_point_rise_s: float = Field(
        default=0.4, ge=0.05, le=60, description="with feed_forward: way of a stepped set-point to its new value"
    )
    probing: ProbingMode | ProbingConfig = Field(
        default="off", description="small known changes of the tension; a word alone is the mode"
    )

    @property
    def probes(self) -> ProbingConfig:
        """How the tension is probed."""
        return ProbingConfig(mode=self.probing) if isinstance(self.probing, str) else self.probing


def span_misfits(spans: Sequence[int], count: int) -> Iterator[str]:
    """Why these can't be the spans of controllers of a line that has so many."""
    yield from _each_once(spans, count, "one axis can keep one tension")


def _each_once(spans: Sequence[int], count: int, why: str) -> Iterator[str]:
    for span in spans:
        if span > count:
            yield f"a span of 1 to {count}, '{span}' is none"
    if len(set(spans)) < len(spans):
        yield f"each span at most once: {why}"


def estimate_misfits(twin: EstimationConfig, machine: ModelParameters) -> Iterator[str]:
    """Why a twin can't estimate what it is told to."""
    given = [estimate.span for estimate in twin.estimate if estimate.span is not None]
    if len(twin.estimate) > len(given) and len(twin.estimate) > 1:
        yield "'estimate' with a span in every entry, or one entry without a span for all of them"
    yield from _each_once(given, machine.span_count, "E of a span is found in one way")
    if machine.span_count < 2 or machine.stations is not None:
        return
    methods = twin.by_span(machine.span_count)
    if any(isinstance(estimate, InputConfig) for estimate in methods.values()):
        yield "another method than 'input', which is for a line of one span"
    first = min(methods)
    unloaded = [axis for axis in range(first + 1, machine.axis_count + 1) if not machine.carries_web_load(axis)]
    if unloaded:
        yield (
            f"'estimate' at a span behind which the web loads every roller: span {first} can't be seen in "
            f"torques as long as 'machine.web_load' says that axis {unloaded[0]} carries none"
        )


def stations_misfit(
    machine: ModelParameters, controls: Iterable[TensionControlConfig], ahead: str, names: Collection[str]
) -> str | None:
    """Why a bench can't have the stations of its machine, in one line, or None.

    `ahead`: key of the twin's that is given and needs driven rollers alone, "" for none; `names`: of other parts.
    """
    rollers, before = machine.line_rollers, axes_before_spans(machine)
    if rollers[0].axis is None or rollers[-1].axis is None:
        return "'stations' that begin and end with a driven roller or reel"
    sections = [before[control.span - 1] for control in controls]
    if len(set(sections)) < len(sections):
        return "one controller between two driven rollers: one axis can keep one tension"
    if ahead:
        return f"no '{ahead}' on a line with 'stations:', or {ONLY_DRIVEN}"
    if any(control.probes.mode != "off" for control in controls):
        return f"no 'probing' on a line with 'stations:', or {ONLY_DRIVEN}"
    twice = [name for name in station_names(machine) if name in names]
    return f"names that differ: a station and another part are both named {twice[0]}" if twice else None


def station_names(machine: ModelParameters) -> tuple[str, ...]:
    """Of dancers and accumulators, which have a position, then of reels, which have a radius."""
    reels = (roller.station for roller in machine.line_rollers)
    return (
        *(carriage.station.name for carriage in machine.carriages),
        *(reel_name(reel) for reel in reels if isinstance(reel, Reel)),
    )


def measured_misfit(measured: Sequence[str], machine: ModelParameters) -> str | None:
    """Why a line can't have sensors of these stations, or None."""
    known = station_names(machine)
    unknown = [name for name in measured if name not in known]
    if not unknown:
        return None
    return f"'load.measured' of dancers, accumulators and reels ({', '.join(known) or 'none here'}), not {unknown[0]}"
