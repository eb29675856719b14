"""What a bench config has of a web line beside its machine: the imitated web, the tension loops, what is estimated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

from pydantic import Field, PositiveFloat

from hilbench.block import Block
from hilbench.estimation.web_line.config import EstimationConfig, InputConfig
from hilbench.plant.web_line.parameters import Length, ModelParameters, Modulus


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
    if machine.span_count < 2:
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
