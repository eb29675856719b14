"""Messages between a running bench and its live diagnosis, with the findings of the latter.

The bench sends samples, a chunk at a time, and gets one answer to each. Times are SYNCs as `CycleSample` counts
them: in lockstep an answer belongs to a cycle, not to a moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

#: Cycles of a chunk of samples.
CHUNK_CYCLES = 250


#: Of a machine, as `FoundEffect` has their numbers.
_PARTS: Final = ("axis", "span")


def part_words(*numbers: int | None) -> str:
    """The part of the machine that has the number of the two (axis, span) that is given: "axis 2"; "" of neither."""
    named = zip(_PARTS, numbers, strict=True)
    return next((f"{name} {number}" for name, number in named if number is not None), "")


@dataclass(frozen=True)
class FoundValue:
    """A parameter of an effect with its 95 % interval, in `unit`."""

    value: float
    ci95: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """An effect that the model lacks, by its id; `axis` and `span` count from 1, None where it has none."""

    effect: str
    axis: int | None
    span: int | None
    parameters: Mapping[str, FoundValue]
    tied_with: tuple[str, ...] = ()  #: effects that these data can't distinguish it from

    @property
    def part(self) -> str:
        """Part of the machine that it is of: "axis 2"; "" if none."""
        return part_words(self.axis, self.span)

    @property
    def place(self) -> str:
        """Place as in paths of quantities and metrics: ``coulomb_friction.axis2``."""
        return ".".join(filter(None, (self.effect, self.part.replace(" ", ""))))


@dataclass(frozen=True)
class FoundGap:
    """Rms residual, measured less predicted (means over some cycles, on data that neither model has seen),
    before and after; `noise_floor`: its value while no effect is lacking."""

    signal: str
    unit: str
    before: float
    after: float
    noise_floor: float


@dataclass(frozen=True)
class DiagnosisUpdate:
    """One finding of the diagnosis; `begun_cycle`: since when its subject exists.

    ``seen``: model and measurement differ; ``named``: by `effects`, or `gone` ones; ``dismissed``: was not confirmed
    by data that neither model has seen; ``decided``: with `model` (effects as `hilbench.twin.model_switch.with_effects`
    reads them, "" for the configured model) the residual is smaller on data that neither has seen; ``ended``: the
    residual has vanished, or is not due to the model's structure; ``unknown``: no effect of the vocabulary
    explains it.
    """

    what: Literal["seen", "named", "dismissed", "decided", "ended", "unknown"]
    begun_cycle: int
    text: str
    effects: tuple[FoundEffect, ...] = ()
    gone: tuple[FoundEffect, ...] = ()
    model: str | None = None
    gap: FoundGap | None = None


@dataclass(frozen=True)
class GapRow:
    """Size of the residual over some cycles: rms of measured less predicted torque, N·m, without noise; NaN at rest.

    `configured`: of the model as it was configured; `in_use`: of the one that the twin has.
    """

    cycle: int
    signal: str
    configured: float
    in_use: float


@dataclass(frozen=True)
class Ready:
    """Diagnosis to bench, before anything else: all that it runs is loaded and compiled."""


@dataclass(frozen=True)
class Samples:
    """Bench to diagnosis: rows as binary64, up to and with that of a SYNC.

    A row is all signals, then the cycle of the plant by the clock (the number of the SYNC, and of all that the bench
    was too late to send), and 1.0 where an answer of a drive is one to an earlier SYNC.
    """

    cycle: int
    rows: bytes

    @classmethod
    def of(cls, cycle: int, signals: NDArray[np.float64]) -> Samples:
        """Rows (n, signals) of SYNCs none of which was left out, answered in time."""
        cycles = np.arange(cycle + 1.0 - len(signals), cycle + 1.0)
        return cls(cycle, np.column_stack([signals, cycles, np.zeros(len(signals))]).tobytes())


OutcomeKind = Literal["applied", "refused", "announced"]


@dataclass(frozen=True)
class ProposalOutcome:
    """Message from bench to diagnosis: outcome of a proposal, or a change that a person has announced.

    ``applied``, ``refused``: the last `decided` model; ``announced``: the machine has `model` from this cycle on.
    """

    cycle: int
    what: OutcomeKind
    model: str = ""


@dataclass(frozen=True)
class DiagnosisAnswer:
    """Diagnosis to bench: the answer to `Samples` of the same cycle."""

    cycle: int
    news: tuple[DiagnosisUpdate, ...] = ()
    gaps: tuple[GapRow, ...] = ()


@dataclass
class ModelChange:
    """State of one model change of a run; times in s of experiment time, None for what has not happened."""

    begun_s: float
    effects: tuple[FoundEffect, ...]
    gone: tuple[FoundEffect, ...]
    named_s: float
    gap: FoundGap | None = None
    decided_s: float | None = None
    applied_s: float | None = None
    refused: bool = False
    tension_step_N: float | None = None  #: largest change of the simulated tension from one cycle to the next
    model: str | None = field(default=None, repr=False)

    @property
    def named_after_s(self) -> float:
        """Time from the divergence of model and measurement until the effect was named."""
        return self.named_s - self.begun_s

    @property
    def applied_after_s(self) -> float | None:
        """Time from the divergence of model and measurement until the twin had switched over."""
        return None if self.applied_s is None else self.applied_s - self.begun_s
