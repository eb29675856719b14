"""`result.json`: the verdict of a run, as a program reads it (design: files)."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from datetime import datetime
from importlib import metadata
from math import isfinite
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from hilbench.bench.prediction.announcements import Announcement
from hilbench.bench.reports.diagnosis_updates import FoundGap, FoundValue, GapRow, ModelChange, part_words
from hilbench.block import Strict
from hilbench.json_file import JsonFile
from hilbench.plant.effects import find_effect
from hilbench.results.provenance import Provenance
from hilbench.runs.criteria import CriterionResult, RunVerdict, verdict_of
from hilbench.runs.events import Changed, Event
from hilbench.runs.figures import finite_or_none
from hilbench.runs.metrics import Judgement, StepFigures
from hilbench.topology.config import BenchConfig
from hilbench.twin.estimated_errors import EstimatedModelError

Count = Annotated[int, Field(ge=0)]

#: Libraries whose version a result depends on.
LIBRARIES = ("numpy", "numba", "scipy", "canopen", "python-can", "asammdf", "pydantic", "matplotlib")
_HISTOGRAM_BINS = 60
#: Steps and events that a result holds, of a run with more the first.
MOST_EVENTS = 500
#: Standard deviations on either side of which 95 % of a normal variable lies.
_NORMAL_95 = 1.959964
#: Pieces of the history of the gap that it holds.
MOST_GAPS = 2000


class _WithOptions(Strict):
    """A block whose optional members are left out, rather than null, where there is nothing to say."""

    @model_serializer(mode="wrap")
    def _without_absent_options(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        fields: dict[str, Any] = serialize(self)
        known = type(self).model_fields
        return {name: value for name, value in fields.items() if value is not None or known[name].is_required()}


class Jitter(Strict):
    """Lateness of SYNC against its absolute time, in µs: median, 99 %, 99.9 %, largest."""

    p50: float
    p99: float
    p999: float
    max: float


class Histogram(Strict):
    """Histogram of lateness: `counts[i]` cycles between `edges_us[i]` and `edges_us[i + 1]`."""

    edges_us: list[float]
    counts: list[Count]

    @model_validator(mode="after")
    def _edges_enclose_counts(self) -> Self:
        if len(self.edges_us) != len(self.counts) + 1:
            raise ValueError("one edge more than counts")
        return self


class Late(Strict):
    """Late answers of a participant to SYNC since the drives were enabled: its last one was used again
    (a drive), or one of an earlier SYNC (the twin), `oldest_cycles` old at most."""

    cycles: Count
    share_pct: float
    oldest_cycles: Count


#: Share of late samples, %, from which on there is a warning.
_LATE_WARNING_PCT = 1.0


class Timing(_WithOptions):
    """Timing of the cycles. `cycle_us` is the nominal cycle, `cycles` has those of the recording, without start and
    stop of the drives; `jitter_us` is None where nobody measured it.

    `realtime_factor` is bus time over wall time; `bus_load_pct` the mean share of the bus' capacity in use.
    `lost_frames` were received for the bench and not read in time (None: the bus interface does not count them),
    `first_loss_s` is when the first was noticed, in experiment time; `lost_frames_of` has the same count of the
    processes that the bench started. `late` has who answered late in any cycle (None: nobody looked).
    By the clock SYNC goes out without the bench: `missed` cycles were not run, and in `late_set_points` cycles set
    points were sent behind their SYNC and acted with the next, or were left out, as they would have been.
    """

    pace: Literal["realtime", "lockstep"]
    cycle_us: float = Field(gt=0)
    cycles: Count
    missed: Count
    jitter_us: Jitter | None
    realtime_factor: float | None
    bus_load_pct: float | None
    late_set_points: Count | None = None
    lost_frames: Count | None = None
    first_loss_s: float | None = None
    lost_frames_of: dict[str, Count | None] | None = None
    late: dict[str, Late] | None = None
    jitter_histogram: Histogram | None = None

    @classmethod
    def of(cls, config: BenchConfig, cycles: int, missed: int = 0, **known: Any) -> Self:
        """Timing of a run of a bench; of what is not `known` nobody knows anything."""
        unknown = dict.fromkeys(("jitter_us", "realtime_factor", "bus_load_pct"))
        about = {"pace": config.pace, "cycle_us": config.cycle_time_s * 1e6, "cycles": cycles, "missed": missed}
        return cls.model_validate(unknown | about | known)

    def metrics(self) -> dict[str, float | None]:
        """The timing as metrics that criteria can bound."""
        late = None if self.late is None else max((each.share_pct for each in self.late.values()), default=0.0)
        return {
            "cycles_missed": float(self.missed),
            "jitter_p99_us": self.jitter_us.p99 if self.jitter_us else None,
            "jitter_max_us": self.jitter_us.max if self.jitter_us else None,
            "realtime_factor": self.realtime_factor,
            "bus_load_pct": self.bus_load_pct,
            "lost_frames": None if self.lost_frames is None else float(self.lost_frames),
            "late_samples_pct": late,
        }

    def warnings(self) -> list[str]:
        """Warnings to read before the run is trusted: one line for each process that lost frames."""
        texts = []
        if self.lost_frames:
            since = "" if self.first_loss_s is None else f", first noticed at t = {self.first_loss_s:.3f} s"
            texts.append(f"the bench lost {self.lost_frames} frames{since}: they are missing in trace and measurements")
        for process, lost in (self.lost_frames_of or {}).items():
            if lost:
                texts.append(f"the {process} lost {lost} frames: set points or measurements are missing there")
        for participant, late in (self.late or {}).items():
            if late.share_pct >= _LATE_WARNING_PCT:
                oldest = f"up to {late.oldest_cycles} cycles old" if late.oldest_cycles > 1 else "a cycle old"
                texts.append(f"{participant}: {late.share_pct:.1f} % of the samples came late, {oldest}")
        return texts


def jitter(lateness_us: ArrayLike) -> tuple[Jitter, Histogram] | tuple[None, None]:
    """Percentiles and histogram of every cycle's lateness (µs, one value per cycle); None without cycles."""
    late = np.asarray(lateness_us, np.float64)
    if not len(late):
        return None, None
    p50, p99, p999 = np.percentile(late, [50, 99, 99.9])
    counts, edges = np.histogram(late, bins=_HISTOGRAM_BINS)
    return (
        Jitter(p50=float(p50), p99=float(p99), p999=float(p999), max=float(late.max())),
        Histogram(edges_us=edges.tolist(), counts=counts.tolist()),
    )


class Fault(Strict):
    """Something that went wrong in a run: when (s of bus time, None before the first cycle), where, what."""

    time_s: float | None
    source: str
    text: str


class Warned(_WithOptions):
    """Warnings of a run, counted by source and kind: the first time (s of bus time) and its text, the number
    of times, and, where there were several, the last time and its text."""

    time_s: float | None
    source: str
    text: str
    count: int = Field(default=1, ge=1)
    last_time_s: float | None = None
    last_text: str | None = None

    def line(self) -> str:
        """Line for a terminal."""
        when = "" if self.time_s is None else f"t = {self.time_s:.3f} s, "
        return f"{when}{self.source}: {self.text}{self.repeated()}"

    def repeated(self) -> str:
        """Text about further times, "" where it was the only one."""
        if self.count == 1:
            return ""
        last = "" if self.last_text in (None, self.text) else f", then: {self.last_text}"
        until = "" if self.last_time_s is None else f", last at t = {self.last_time_s:.3f} s"
        return f" ({self.count} times{until}{last})"


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed"


class Environment(Strict):
    """Environment of a run, by which its result can be judged later and elsewhere."""

    hilbench: str
    python: str
    platform: str
    libraries: dict[str, str]
    seed: int | None

    @classmethod
    def here(cls, seed: int | None) -> Self:
        """The environment of this process."""
        return cls(
            hilbench=_version("hilbench"),
            python=platform.python_version(),
            platform=f"{platform.system()} {platform.release()} {platform.machine()}",
            libraries={name: _version(name) for name in LIBRARIES},
            seed=seed,
        )


def _shared(block: type[Strict], *sources: object) -> dict[str, Any]:
    """The fields of a block that one of these has under the same name, the first one that has it."""
    return {
        name: getattr(source, name)
        for source in reversed(sources)
        for name in block.model_fields
        if hasattr(source, name)
    }


class EventRecord(Strict):
    """A step, a ramp, or a mark (the twin was lost), from when to when (s of experiment time)."""

    kind: Literal["step", "ramp", "mark"]
    text: str
    start_s: float
    end_s: float
    changes: list[Changed]  #: SI; None where nobody knows the value

    @classmethod
    def of(cls, event: Event) -> Self:
        """Record for the file."""
        changes = [
            Changed(each.path, finite_or_none(each.before), finite_or_none(each.after)) for each in event.changes
        ]
        return cls(kind=event.kind, text=str(event), start_s=event.start_s, end_s=event.end_s, changes=changes)


class StepRecord(Strict):
    """One step with its figures by metric, from when it acts to the next event; `reasons`: why one has no value."""

    number: int
    text: str
    time_s: float
    until_s: float
    figures: dict[str, float | None]
    reasons: dict[str, str]

    @classmethod
    def of(cls, step: StepFigures) -> Self:
        """Record for the file."""
        return cls(
            number=step.number,
            text=str(step.event) if step.event else str(step),
            time_s=step.start_s,
            until_s=step.until_s,
            figures={name: finite_or_none(figure.value) for name, figure in step.figures.items()},
            reasons={name: figure.reason for name, figure in step.figures.items() if figure.reason},
        )


class PredictedLimit(_WithOptions):
    """A crossing of a limit as it was announced at `t_s`, and what came of it (times in s of experiment time).

    `expected_s`, with the times before and after which one future in ten has it; `crossed_s`: when it came;
    `withdrawn_s`: when it was not expected any more; `action`: what the bench did.
    """

    t_s: float
    quantity: str
    signal: str
    level: Literal["warning", "trip"]
    limit: float
    unit: str
    probability: float
    expected_s: float
    earliest_s: float
    latest_s: float
    action: str
    crossed_s: float | None = None
    withdrawn_s: float | None = None

    @classmethod
    def of(cls, made: Announcement) -> Self:
        """Record for the file."""
        watched = made.crossing.watched
        return cls(quantity=watched.name, **_shared(cls, made, made.crossing, watched))


class EstimatedRecord(Strict):
    """A parameter of an effect as the twin found it while the machine ran, with its 95 % interval, and where.

    Not `separable`: the data of the run don't tell it; the interval is what was assumed before. `tied_with`: effects
    that it can't be distinguished from: the value is that where they are not there.
    """

    effect: str
    place: str
    parameter: str
    value: float
    ci95: tuple[float, float]
    unit: str
    separable: bool
    tied_with: list[str] = Field(default_factory=list)

    @classmethod
    def of(cls, found: EstimatedModelError) -> Self:
        """Record for the file."""
        half = _NORMAL_95 * found.deviation
        return cls(
            ci95=(found.value - half, found.value + half),
            unit=find_effect(found.effect).parameter(found.parameter).unit,
            **_shared(cls, found),
        )


class FoundRecord(Strict):
    """Finding while the bench ran: an effect that had come, or (`gone`) that of a model that had gone.

    `t_s`: since when model and measurement parted (s of experiment time); how long after that it was named, and in the
    twin's model (None: it never was; `refused`: by the operator); `tension_step_N`: largest change of a simulated
    tension from one cycle to the next while the twin went over; `tied_with`: what the data could not tell it from.
    """

    t_s: float
    effect: str
    axis: int | None
    span: int | None
    parameters: dict[str, FoundValue]
    named_after_s: float
    applied_after_s: float | None
    tension_step_N: float | None
    gap: FoundGap | None
    gone: bool = False
    refused: bool = False
    tied_with: list[str] = Field(default_factory=list)

    @property
    def part(self) -> str:
        """Its part of the machine: "axis 2"; "" of what is everywhere."""
        return part_words(self.axis, self.span)

    @classmethod
    def of(cls, change: ModelChange) -> list[Self]:
        """Records for the file: one for each effect of a change."""
        both = [*((effect, False) for effect in change.effects), *((effect, True) for effect in change.gone)]
        return [cls(**_shared(cls, effect, change) | {"t_s": change.begun_s, "gone": gone}) for effect, gone in both]


class StreamRecord(Strict):
    """A stream of the run's samples: to what, how many, and how many of them were dropped."""

    to: str
    samples: Count
    dropped: Count

    def warnings(self) -> list[str]:
        """Warnings about the stream."""
        share = 100.0 * self.dropped / max(self.samples, 1)
        lost = f"stream to {self.to}: {self.dropped} of {self.samples} samples were dropped ({share:.1f} %)"
        return [lost] if self.dropped else []


class GapHistory(Strict):
    """Size of the gap between a measured signal and what models say of it, without what is noise (None: at rest).

    `configured`: of the model as it was configured; `in_use`: of the one that the twin had then.
    """

    signal: str
    unit: str
    t_s: list[float]
    configured: list[float | None]
    in_use: list[float | None]

    @classmethod
    def of(cls, rows: Sequence[GapRow], changes: Sequence[ModelChange], time_s: Callable[[int], float]) -> Self | None:
        """History of at most `MOST_GAPS` pieces, the largest of each few of a longer run; None without one: of the
        signal that showed the first change, or that of the largest gap. `time_s`: of a cycle."""
        if not rows:
            return None
        shown = next((change.gap.signal for change in changes if change.gap is not None), None)
        if shown is None:
            shown = max(rows, key=lambda row: row.in_use if isfinite(row.in_use) else -1.0).signal
        rows = [row for row in rows if row.signal == shown]
        every = -(-len(rows) // MOST_GAPS)
        parts = [rows[at : at + every] for at in range(0, len(rows), every)]
        return cls(
            signal=rows[0].signal,
            unit="N·m",
            t_s=[time_s(part[-1].cycle) for part in parts],
            configured=[_largest([row.configured for row in part]) for part in parts],
            in_use=[_largest([row.in_use for row in part]) for part in parts],
        )


def _largest(values: Sequence[float]) -> float | None:
    return max((value for value in values if isfinite(value)), default=None)


class Result(_WithOptions, JsonFile):
    """The verdict of one run. `passed` holds exactly when every criterion does and no fault stopped the run; null where
    there was no criterion, and nothing was judged.

    `not_judged`: why a metric has no value; `steps`: every step of the run with its figures; `events`: these and all
    else that happened, the first `MOST_EVENTS` of each.
    `found`: what the diagnosis beside the run found, where there was one, and how the gap went (`gap_history`).
    `estimated`: errors of its model that the twin found while the machine ran.
    `commissioned`: what the twin began with, where that was measured before, and how old it is.
    `warnings`: what did not stop the run (a limit's warning level, an EMCY message, a tension loop that opened), each
    kind once with its count.
    `predicted`: crossings of limits that were announced, where the config asks for predictions.
    """

    described: ClassVar[str] = "a run's result"

    passed: bool | None
    began: datetime | None = None  #: UTC
    criteria: list[CriterionResult]
    metrics: dict[str, float | None]
    timing: Timing
    faults: list[Fault]
    environment: Environment | None = None
    provenance: Provenance | None = None
    warnings: list[Warned] | None = None
    not_judged: dict[str, str] | None = None
    steps: list[StepRecord] | None = None
    events: list[EventRecord] | None = None
    predicted: list[PredictedLimit] | None = None
    found: list[FoundRecord] | None = None
    gap_history: GapHistory | None = None
    streams: list[StreamRecord] | None = None
    estimated: list[EstimatedRecord] | None = None
    commissioned: str | None = None

    @classmethod
    def of(
        cls,
        criteria: Sequence[CriterionResult],
        metrics: dict[str, float | None],
        timing: Timing,
        faults: Sequence[Fault],
        environment: Environment | None = None,
        *,
        judged: Judgement | None = None,
        predicted: Sequence[Announcement] | None = None,
        estimated: Sequence[EstimatedModelError] = (),
        **further: Any,
    ) -> Self:
        """A result whose `passed` follows from its criteria and faults; `further` fields are as they are."""
        judgements = [criterion.of_cut_off_run() if faults else criterion for criterion in criteria]
        holds = all(criterion.passed for criterion in judgements) if judgements else None
        return cls(
            passed=False if faults else holds,
            criteria=judgements,
            metrics=metrics,
            timing=timing,
            faults=list(faults),
            environment=environment,
            not_judged=judged.not_judged() if judged else None,
            steps=[StepRecord.of(step) for step in judged.steps[:MOST_EVENTS]] if judged else None,
            events=[EventRecord.of(event) for event in judged.events[:MOST_EVENTS]] if judged else None,
            predicted=None if predicted is None else [PredictedLimit.of(made) for made in predicted[:MOST_EVENTS]],
            estimated=[EstimatedRecord.of(each) for each in estimated] or None,
            **further,
        )

    @property
    def verdict(self) -> RunVerdict:
        """Verdict in one word."""
        source = self.faults[0].source if self.faults else None
        return verdict_of(source, judged=bool(self.criteria), passed=self.passed)

    def all_warnings(self) -> list[str]:
        """One line for each: losses of frames, then what the bench noted, in the order of time."""
        lost = [line for stream in self.streams or [] for line in stream.warnings()]
        return [*self.timing.warnings(), *lost, *(warning.line() for warning in self.warnings or [])]
