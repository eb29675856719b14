"""Metrics of a run: those of its kind of machine, of every step and of the whole run.

Arrays are one-dimensional, over one time base `t_s` (s, strictly increasing). Every step of every quantity is judged
on its own (`judge`), from the moment it acts to the next step, ramp or end of a ramp. A run without a step is
judged over its *working window*: the longest segment in which the machine runs at its working speed
(`hilbench.runs.figures.working_window`), or in which it moves at all where ramps are its work.
A figure that a step cannot have is None and says why; nothing is put in its place.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.machine_kinds import machine_part, recorded
from hilbench.runs import estimated_errors
from hilbench.runs.events import Event, find_events, of_open_loop
from hilbench.runs.figures import finite_or_none, working_window
from hilbench.runs.machines import web_line
from hilbench.runs.machines.machine import MachineMetrics
from hilbench.runs.segment import Channels, Figure, Metric, Segment, UnknownFigureError
from hilbench.topology.signals import Shape, kind_of, shape_of, smallest_shapes

_NUMBERED: Final = re.compile(r"[A-Za-z]+([1-9]\d{0,2})_\w+")

_NO_SUCH_METRIC = "there is no such metric"
_NO_TIMING = "the timing was not measured"
_NO_PREDICTION = "the config asks for no prediction (twin: prediction)"
_NOT_COUNTED = "this bus interface does not count them, or no cycle ran"

#: What is counted of the whole run.
OF_RUNS: Final = {
    "cycles_missed": Metric("", "cycles whose deadline passed", _NO_TIMING),
    "jitter_p99_us": Metric("µs", "99th percentile of the lateness of SYNC", _NO_TIMING),
    "jitter_max_us": Metric("µs", "largest lateness of SYNC", _NO_TIMING),
    "realtime_factor": Metric("", "bus time over wall time", _NO_TIMING),
    "lost_frames": Metric("", "frames that reached the interface of the bench and were not read in time", _NOT_COUNTED),
    "late_samples_pct": Metric(
        "%", "cycles in which the participant that is late most often had not answered in time", _NO_TIMING
    ),
    "bus_load_pct": Metric("%", "bits on the bus over its capacity", _NO_TIMING),
    "twin_refusals": Metric(
        "", "how often torques and encoders have opened a loop against the twin", "no loop is watched"
    ),
    "limits_predicted": Metric("", "announced crossings of limits that came", _NO_PREDICTION),
    "limits_not_predicted": Metric("", "crossings of limits that came unannounced", _NO_PREDICTION),
    "limits_predicted_in_vain": Metric(
        "", "announced crossings of limits that did not come, although nothing was done about them", _NO_PREDICTION
    ),
    "prediction_lead_s": Metric(
        "s", "least time from the announcement of a crossing to the crossing", "no crossing was announced and came"
    ),
}

#: Steps whose reasons are stated in one line.
_MOST_REASONS: Final = 3


@cache
def of_steps() -> Mapping[str, MachineMetrics]:
    """What the smallest machine of each kind has of its steps."""
    return {kind: of(smallest_shapes()[kind]) for kind, of in recorded("metrics").items() if kind in smallest_shapes()}


@cache
def all_metrics() -> Mapping[str, Metric]:
    """Every metric of the smallest machines: of several kinds with one the first's."""
    first, *others = of_steps().values()
    found = {name: metric for machine in (first, *others, first) for name, metric in machine.metrics.items()}
    return {**found, **OF_RUNS, **estimated_errors.METRICS}


def metrics_of(kind: str, shape: Shape) -> MachineMetrics:
    """Step metrics of a kind of machine."""
    metrics: MachineMetrics = machine_part(kind, "metrics")(shape)
    return metrics


@cache
def find_metric(name: str) -> Metric | None:
    """Metric of a name, whatever the machine; None for a name that is no metric."""
    if name in all_metrics():
        return all_metrics()[name]
    numbered = _NUMBERED.fullmatch(name)
    if numbered is None:
        return estimated_errors.find_metric(name)
    return web_line.metrics_of_number(int(numbered[1])).get(name)


def kind_of_figures(names: Iterable[str]) -> str:
    """The kind of machine that most of the metrics with these names are of."""
    given = list(names)
    return max(of_steps(), key=lambda kind: sum(name in of_steps()[kind].metrics for name in given))


@dataclass(frozen=True)
class StepFigures:
    """A segment of a run that is judged on its own, with its figures by metric.

    `number` counts the steps from 1; it is 0, and `event` None, for the working window of a run without steps.
    A metric that such a step has not (overshoot of E when friction steps) is left out.
    """

    number: int
    event: Event | None
    start_s: float
    until_s: float
    figures: Mapping[str, Figure]

    def __str__(self) -> str:
        return f"step {self.number} ({self.event} at t = {self.start_s:g} s)" if self.event else "the working window"


@dataclass(frozen=True)
class Judgement:
    """Every step of a run with its figures, and what else happened (ramps, marks)."""

    steps: Sequence[StepFigures]
    events: Sequence[Event] = field(default=())
    machine: MachineMetrics = field(default_factory=lambda: next(iter(of_steps().values())))

    def figures(self, metric: str) -> list[tuple[StepFigures, Figure]]:
        """The figures of one metric, of the steps that have it."""
        return [(step, step.figures[metric]) for step in self.steps if metric in step.figures]

    def metrics(self) -> dict[str, float | None]:
        """One number a metric: the worst (largest in size) of all steps; None where no step has one, or where what was
        waited for never came."""
        return {name: self._worst(name) for name in self.machine.metrics}

    def absent(self, metric: str) -> str:
        """Why a run of this machine may not have a metric."""
        known = self.machine.metrics.get(metric) or find_metric(metric)
        return known.absent if known is not None else _NO_SUCH_METRIC

    def not_judged(self) -> dict[str, str]:
        """Why a metric is None."""
        return {name: self.reason(name) for name in self.machine.metrics if self._worst(name) is None}

    def reason(self, metric: str) -> str:
        """Why not every step has a value of a metric; "" where all have."""
        found = self.figures(metric)
        if not found:
            return self.absent(metric)
        missing = [(step, figure) for step, figure in found if figure.value is None]
        return missing[0][1].reason if len(self.steps) == 1 and missing else reasons(missing)

    def _worst(self, metric: str) -> float | None:
        found = self.figures(metric)
        if any(figure.longer_than_s is not None for _, figure in found):
            return None
        by = next((group[-1] for group in self.machine.together if metric in group), metric)
        known = [step for step, figure in found if finite_or_none(figure.value) is not None]
        if not known:
            return None
        return max(known, key=lambda step: abs(step.figures[by].value or 0.0)).figures[metric].value


class NotJudgedError(AssertionError):
    """A test asks for a metric that the run does not show; the text gives the reason."""


class Metrics(dict[str, float | None]):
    """Metrics by name, None for those that a run does not show: `get` returns that, `[name]` raises NotJudgedError."""

    def __init__(self, values: Mapping[str, float | None], reasons: Mapping[str, str]) -> None:
        super().__init__(values)
        self._reasons = reasons

    def __getitem__(self, name: str) -> float:
        value = super().__getitem__(name)
        if value is None:
            raise NotJudgedError(f"no {name}: {self._reasons.get(name, 'the run does not show it')}")
        return value


def reasons(missing: Sequence[tuple[StepFigures, Figure]]) -> str:
    """Why steps have no value: of many the first."""
    causes = [f"{step}: {figure.reason}" for step, figure in missing[:_MOST_REASONS]]
    more = len(missing) - len(causes)
    return "; ".join([*causes, f"and {more} more steps"] if more else causes)


def evaluate_metrics(channels: Channels, *, journal: Sequence[Event] = ()) -> dict[str, float | None]:
    """The metrics of a recording that its arrays decide (the timing's come from the cycle): see `judge`."""
    return judge(channels, journal=journal).metrics()


def judge(channels: Channels, *, journal: Sequence[Event] = ()) -> Judgement:
    """Judge every step of a recording, or its working window where nothing stepped.

    `channels` are named as in `hilbench.topology.signals`, of equal length; `journal`: what the bench noted of its
    steps (`hilbench.runs.events.journal_events`), for those that no signal shows.
    """
    machine = metrics_of(kind_of(channels), shape_of(channels))
    events = find_events(channels, journal)
    time_s = np.asarray(channels["t_s"], np.float64)
    marks = [event for event in events if of_open_loop(event)]
    motion = [e for e in events if machine.moves_always and e.kind == "ramp" and e.of(machine.speed.path) is not None]
    ending = [event for event in events if event not in marks and event not in motion]
    events = [event for event in events if event in ending or event in journal]
    steps = [event for event in events if event.kind == "step"]
    if steps:
        judged = []
        for number, step in enumerate(steps, 1):
            part = _segment(time_s, step.end_s, _next(ending, step.end_s))
            if part.start < part.stop:  # nothing is recorded behind the last set-point of a run that a fault ended
                judged.append(_judge(machine, Segment(channels, part, step, marks), number))
        return Judgement(judged, events, machine)
    window = _window(machine, channels, time_s)
    if window is None:
        return Judgement((), events, machine)
    inside = [event.end_s for event in ending if time_s[window][0] < event.end_s < time_s[window][-1]]
    if inside:
        window = slice(int(np.searchsorted(time_s, max(inside))), window.stop)
    return Judgement([_judge(machine, Segment(channels, window, None, marks), 0)], events, machine)


def _window(machine: MachineMetrics, channels: Channels, time_s: Array) -> slice | None:
    """Working window; None where the machine never ran, or its speed was not recorded."""
    if machine.speed.signal not in channels:
        return None
    command = np.asarray(channels[machine.speed.signal], np.float64)
    if not machine.moves_always:
        return working_window(time_s, command)
    moves = np.flatnonzero(np.nan_to_num(command))
    return slice(int(moves[0]), int(moves[-1]) + 1) if len(moves) > 1 else None


def _next(events: Sequence[Event], after_s: float) -> float:
    """Time at which the next event begins, or a ramp in progress ends."""
    times = [time for event in events for time in (event.start_s, event.end_s) if time > after_s]
    return min(times, default=np.inf)


def _segment(time_s: Array, start_s: float, until_s: float) -> slice:
    half_s = float(np.min(np.diff(time_s))) / 2
    return slice(*(int(at) for at in np.searchsorted(time_s, (start_s - half_s, until_s - half_s))))


def _judge(machine: MachineMetrics, segment: Segment, number: int) -> StepFigures:
    figures = {}
    for name, metric in machine.metrics.items():
        if metric.figure is not None and metric.judged(segment):
            try:
                figures[name] = metric.figure(segment)
            except UnknownFigureError as unknown:
                figures[name] = Figure(None, str(unknown))
    start_s, until_s = (float(segment.t_s[at]) for at in (0, -1))
    return StepFigures(number, segment.event, start_s, until_s, figures)
