"""What a run is judged by: pure functions on recorded arrays.

Arrays are one-dimensional, over one time base `t_s` (s, strictly increasing). Every step of every quantity is judged
on its own (`judge`), from the moment it acts to the next step, ramp or end of a ramp. A run without a step is
judged over its *working window*: the longest stretch in which the line runs at its working speed (`working_window`).
The *settled part* of a signal is the end of such a stretch, without what is left of the transient (`settled_part`).
A figure that a step cannot have is None and says why; nothing is put in its place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.runs.events import STEP_SHARE, Event, find_events
from hilbench.topology.quantities import LINE_SPEED, TENSION_SET_POINT, YOUNGS_MODULUS

Array = NDArray[np.float64]
Number = TypeVar("Number", float, Array)
Channels = Mapping[str, NDArray[Any]]

#: Share of the working speed by which the command may differ from it inside the window.
SPEED_BAND: Final = 1e-3
#: Longest settled part, s, and the least that still counts as one.
SETTLED_S: Final = 5.0
LEAST_SETTLED_S: Final = 1.0
#: Half width of the band the estimate has to enter, as a share of the true E.
E_BAND: Final = 0.01
#: Half width of the band the tension has to come back to, N.
TENSION_BAND_N: Final = 1.0
#: Half width of the band the line speed has to enter, as a share of its step.
SPEED_STEP_BAND: Final = 0.02
#: An excess of at most so many times the rms of the noise is noise, no overshoot.
NOISE_PEAK: Final = 5.0
#: What is left of a transient makes the first third of a signal so many times as uneven as its last; it is looked for
#: where so large a share of what may be cut off was.
_STILL_SETTLING: Final = 3.0
_AT_THE_LIMIT: Final = 0.9


@dataclass(frozen=True)
class Metric:
    """What a metric's number means: its unit, and why a run may not have it."""

    unit: str
    description: str
    absent: str
    of_steps: bool = True  #: each step has a figure of its own


_NOTHING_TO_JUDGE = "nothing stepped and the line never ran, or signals that it needs are not recorded"
_NOT_OF_E = "E did not step, or E_sim_Pa is not recorded"
_NOT_OF_SET_POINT = "the tension set-point did not step, or F_true_N is not recorded"
_NOT_OF_SPEED = "the line speed did not step, or v2_m_s is not recorded"
_NO_STEP = "nothing stepped, or signals that it needs are not recorded"
_NO_TIMING = "the timing was not measured"
_NOT_COUNTED = "this bus interface does not count them, or no cycle ran"

METRICS: Final[dict[str, Metric]] = {
    "E_time_to_1pct_s": Metric("s", "time from a step until the estimate stays within 1 % of the true E", _NO_STEP),
    "E_final_error_pct": Metric(
        "%", "size of the mean relative error of the estimate, settled part", _NOTHING_TO_JUDGE
    ),
    "E_noise_pct": Metric("%", "rms of the estimate about its straight-line trend, settled part", _NOTHING_TO_JUDGE),
    "E_overshoot_pct": Metric(
        "%", "largest excess of the estimate over the new E beyond noise, of the step", _NOT_OF_E
    ),
    "tension_recovery_s": Metric(
        "s", "time from a step until the true tension stays within 1 N of its set-point", _NO_STEP
    ),
    "tension_overshoot_pct": Metric(
        "%", "largest excess of the true tension over a new set-point beyond noise, of the step", _NOT_OF_SET_POINT
    ),
    "tension_rms_error_N": Metric("N", "rms of true tension minus set-point since the step", _NOTHING_TO_JUDGE),
    "tension_peak_error_N": Metric("N", "largest true tension error since the step", _NOTHING_TO_JUDGE),
    "tension_final_error_N": Metric("N", "size of the mean true tension error, settled part", _NOTHING_TO_JUDGE),
    "tension_sim_deviation_N": Metric("N", "largest simulated tension error since the step", _NOTHING_TO_JUDGE),
    "v1_final_m_s": Metric("m/s", "mean velocity of roller 1, settled part of the strain", _NOTHING_TO_JUDGE),
    "v1_expected_m_s": Metric("m/s", "v2·(1+ε_prev)/(1+ε), what mass conservation asks of v1", _NOTHING_TO_JUDGE),
    "v1_deviation_m_s": Metric("m/s", "v1_final_m_s minus v1_expected_m_s", _NOTHING_TO_JUDGE),
    "speed_settling_s": Metric(
        "s", "time from a step of the line speed until v2 stays within 2 % of the step", _NOT_OF_SPEED
    ),
    "speed_overshoot_pct": Metric(
        "%", "largest excess of v2 over the new line speed beyond noise, of the step", _NOT_OF_SPEED
    ),
    "cycles_missed": Metric("", "cycles whose deadline passed", _NO_TIMING, of_steps=False),
    "jitter_p99_us": Metric("µs", "99th percentile of the lateness of SYNC", _NO_TIMING, of_steps=False),
    "jitter_max_us": Metric("µs", "largest lateness of SYNC", _NO_TIMING, of_steps=False),
    "realtime_factor": Metric("", "bus time over wall time", _NO_TIMING, of_steps=False),
    "lost_frames": Metric(
        "", "frames that reached the interface of the bench and were not read in time", _NOT_COUNTED, of_steps=False
    ),
    "late_samples_pct": Metric(
        "%",
        "cycles in which the participant that is late most often had not answered in time",
        _NO_TIMING,
        of_steps=False,
    ),
    "bus_load_pct": Metric("%", "bits on the bus over its capacity", _NO_TIMING, of_steps=False),
}

#: Steps whose reasons are told in one line.
_MOST_REASONS: Final = 3

#: Figures that go together: of several steps those of the step whose last one is the largest.
_TOGETHER: Final = ("v1_final_m_s", "v1_expected_m_s", "v1_deviation_m_s")


@dataclass(frozen=True)
class Figure:
    """One metric of one step: its value, or why there is none.

    `longer_than_s`: what was waited for did not come within that time, so that the value is larger.
    """

    value: float | None
    reason: str = ""
    longer_than_s: float | None = None


@dataclass(frozen=True)
class StepFigures:
    """A stretch of a run that is judged on its own, with its figures by metric.

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

    def figures(self, metric: str) -> list[tuple[StepFigures, Figure]]:
        """The figures of one metric, of the steps that have it."""
        return [(step, step.figures[metric]) for step in self.steps if metric in step.figures]

    def metrics(self) -> dict[str, float | None]:
        """One number a metric: the worst (largest in size) of all steps; None where no step has one, or where what was
        waited for never came."""
        return {name: self._worst(name) for name, metric in METRICS.items() if metric.of_steps}

    def not_judged(self) -> dict[str, str]:
        """Why a metric is None."""
        return {
            name: self.reason(name) for name, metric in METRICS.items() if metric.of_steps and self._worst(name) is None
        }

    def reason(self, metric: str) -> str:
        """Why not every step has a value of a metric; "" where all have."""
        found = self.figures(metric)
        if not found:
            return METRICS[metric].absent
        missing = [(step, figure) for step, figure in found if figure.value is None]
        return missing[0][1].reason if len(self.steps) == 1 and missing else reasons(missing)

    def _worst(self, metric: str) -> float | None:
        found = self.figures(metric)
        if any(figure.longer_than_s is not None for _, figure in found):
            return None
        by = _TOGETHER[-1] if metric in _TOGETHER else metric
        known = [step for step, figure in found if _finite(figure.value) is not None]
        if not known:
            return None
        return max(known, key=lambda step: abs(step.figures[by].value or 0.0)).figures[metric].value


def reasons(missing: Sequence[tuple[StepFigures, Figure]]) -> str:
    """Why steps have no value: of many the first."""
    told = [f"{step}: {figure.reason}" for step, figure in missing[:_MOST_REASONS]]
    more = len(missing) - len(told)
    return "; ".join([*told, f"and {more} more steps"] if more else told)


def evaluate_metrics(
    channels: Channels, *, journal: Sequence[Event] = (), tension_band_N: float = TENSION_BAND_N
) -> dict[str, float | None]:
    """The metrics of a recording that its arrays decide (the timing's come from the cycle): see `judge`."""
    return judge(channels, journal=journal, tension_band_N=tension_band_N).metrics()


def judge(channels: Channels, *, journal: Sequence[Event] = (), tension_band_N: float = TENSION_BAND_N) -> Judgement:
    """Judge every step of a recording, or its working window where nothing stepped.

    `channels` are named as in `hilbench.topology.signals`, of equal length; `journal`: what the bench noted of its
    steps (`hilbench.runs.events.journal_events`), for those that no signal shows.
    """
    events = find_events(channels, journal)
    time_s = np.asarray(channels["t_s"], np.float64)
    steps = [event for event in events if event.kind == "step"]
    if steps:
        judged = []
        for number, step in enumerate(steps, 1):
            part = _stretch(time_s, step.end_s, _next(events, step.end_s))
            judged.append(_judge(channels, part, number, step, tension_band_N))
        return Judgement(judged, events)
    window = working_window(time_s, channels["v2_cmd_m_s"]) if "v2_cmd_m_s" in channels else None
    if window is None:
        return Judgement((), events)
    inside = [event.end_s for event in events if time_s[window][0] < event.end_s < time_s[window][-1]]
    if inside:
        window = slice(int(np.searchsorted(time_s, max(inside))), window.stop)
    return Judgement([_judge(channels, window, 0, None, tension_band_N)], events)


def _next(events: Sequence[Event], after_s: float) -> float:
    """When the next event begins, or a ramp that is under way ends."""
    times = [time for event in events for time in (event.start_s, event.end_s) if time > after_s]
    return min(times, default=np.inf)


def _stretch(time_s: Array, start_s: float, until_s: float) -> slice:
    half_s = float(np.median(np.diff(time_s))) / 2
    return slice(*(int(at) for at in np.searchsorted(time_s, (start_s - half_s, until_s - half_s))))


class _UnknownError(Exception):
    """A figure that cannot be had; its text says why."""


def _judge(channels: Channels, part: slice, number: int, event: Event | None, band_N: float) -> StepFigures:
    stretch = _Stretch({name: np.asarray(values[part], np.float64) for name, values in channels.items()})
    wanted: dict[str, Callable[[], Figure]] = {
        "E_final_error_pct": stretch.E_final_error_pct,
        "E_noise_pct": stretch.E_noise_pct,
        "tension_rms_error_N": stretch.tension_rms_error_N,
        "tension_peak_error_N": stretch.tension_peak_error_N,
        "tension_final_error_N": stretch.tension_final_error_N,
        "tension_sim_deviation_N": stretch.tension_sim_deviation_N,
        "v1_final_m_s": lambda: Figure(stretch.v1_m_s()[0]),
        "v1_expected_m_s": lambda: Figure(stretch.v1_m_s()[1]),
        "v1_deviation_m_s": lambda: Figure(stretch.v1_m_s()[0] - stretch.v1_m_s()[1]),
    }
    if event is not None:
        wanted["E_time_to_1pct_s"] = stretch.E_time_to_1pct
        wanted["tension_recovery_s"] = lambda: stretch.tension_recovery(band_N)
        wanted |= _of_its_quantity(stretch, channels, part, event)
    figures = {}
    for name in METRICS:
        if name in wanted:
            try:
                figures[name] = wanted[name]()
            except _UnknownError as unknown:
                figures[name] = Figure(None, str(unknown))
    start_s, until_s = (float(stretch.t_s[at]) for at in (0, -1))
    return StepFigures(number, event, start_s, until_s, figures)


def _of_its_quantity(
    stretch: _Stretch, channels: Channels, part: slice, event: Event
) -> dict[str, Callable[[], Figure]]:
    """The figures that only a step of that quantity has; its height is what the recording shows, where it does."""

    def height(name: str, path: str) -> float:
        if name in channels:
            before = (
                np.searchsorted(np.asarray(channels["t_s"], np.float64), event.start_s - 0.5 * stretch.sample_s) - 1
            )
            return float(channels[name][part.start]) - float(channels[name][max(int(before), 0)])
        changed = event.of(path)
        return 0.0 if changed is None or changed.before is None else (changed.after or 0.0) - changed.before

    wanted: dict[str, Callable[[], Figure]] = {}
    E_Pa, F_N, v_m_s = (
        height(name, path)
        for name, path in (
            ("E_true_Pa", YOUNGS_MODULUS),
            ("F_ref_N", TENSION_SET_POINT),
            ("v2_cmd_m_s", LINE_SPEED),
        )
    )
    if "E_true_Pa" in channels and abs(E_Pa) > STEP_SHARE * abs(float(channels["E_true_Pa"][part.start])):
        wanted["E_overshoot_pct"] = lambda: stretch.overshoot("E_sim_Pa", "E_true_Pa", E_Pa)
    if event.of(TENSION_SET_POINT) is not None and F_N:
        wanted["tension_overshoot_pct"] = lambda: stretch.overshoot("F_true_N", "F_ref_N", F_N)
    if event.of(LINE_SPEED) is not None and v_m_s:
        wanted["speed_settling_s"] = lambda: stretch.speed_settling(v_m_s)
        wanted["speed_overshoot_pct"] = lambda: stretch.overshoot("v2_m_s", "v2_cmd_m_s", v_m_s)
    return wanted


class _Stretch:
    """The signals from one step to the next event, and the figures they show; _UnknownError says why there is none."""

    def __init__(self, channels: Mapping[str, Array]) -> None:
        self._channels = channels
        self.t_s = channels["t_s"]
        self.hold_s = float(self.t_s[-1] - self.t_s[0])
        self.sample_s = float(np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0

    def _get(self, name: str) -> Array:
        if name not in self._channels:
            raise _UnknownError(f"{name} is not recorded")
        values = self._channels[name]
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise _UnknownError(f"{name} is no number at t = {self.t_s[bad[0]]:g} s")
        return values

    def _relative_error(self) -> Array:
        estimate, true = self._get("E_sim_Pa"), self._get("E_true_Pa")
        if not true.all():
            raise _UnknownError("the true E is 0")
        return np.asarray(estimate / true - 1, np.float64)

    def _tension_error(self) -> Array:
        return self._get("F_true_N") - self._get("F_ref_N")

    def _settled(self, error: Array) -> slice:
        if self.hold_s < LEAST_SETTLED_S - self.sample_s:
            raise _UnknownError(
                f"the hold of {self.hold_s:.3g} s is too short, at least {LEAST_SETTLED_S:g} s are needed"
            )
        return settled_part(self.t_s, error)

    def E_time_to_1pct(self) -> Figure:
        return self._time_in_band(self._relative_error(), E_BAND, f"{100 * E_BAND:g} %")

    def E_final_error_pct(self) -> Figure:
        error = self._relative_error()
        return Figure(abs(100 * float(np.mean(error[self._settled(error)]))))

    def E_noise_pct(self) -> Figure:
        error = self._relative_error()
        part = self._settled(error)
        if still_settling(self.t_s, error):
            raise _UnknownError(f"the estimate still settles at the end of the hold of {self.hold_s:.3g} s")
        return Figure(noise_pct(self.t_s[part], self._get("E_sim_Pa")[part], self._get("E_true_Pa")[part]))

    def tension_recovery(self, band_N: float) -> Figure:
        return self._time_in_band(self._tension_error(), band_N, f"{band_N:g} N")

    def tension_rms_error_N(self) -> Figure:
        return Figure(float(np.sqrt(np.mean(self._tension_error() ** 2))))

    def tension_peak_error_N(self) -> Figure:
        return Figure(float(np.max(np.abs(self._tension_error()))))

    def tension_final_error_N(self) -> Figure:
        error = self._tension_error()
        return Figure(abs(float(np.mean(error[self._settled(error)]))))

    def tension_sim_deviation_N(self) -> Figure:
        return Figure(float(np.max(np.abs(self._get("F_sim_N") - self._get("F_ref_N")))))

    def v1_m_s(self) -> tuple[float, float]:
        """Mean velocity of roller 1, and what mass conservation asks of it."""
        command = np.abs(self._get("v2_cmd_m_s"))
        x1_m, x2_m, strain_prev, strain = map(self._get, ("x1_m", "x2_m", "strain_prev", "strain_true"))
        part = self._settled(strain)
        if command[part].max() == 0:
            raise _UnknownError("the line stands still")
        if np.ptp(command[part]) > SPEED_BAND * command[part].max():
            raise _UnknownError("the line speed changes")
        t_s = self.t_s[part]
        v2_m_s = mean_velocity_m_s(t_s, x2_m[part])
        asked_m_s = expected_v1_m_s(v2_m_s, float(np.mean(strain_prev[part])), float(np.mean(strain[part])))
        return mean_velocity_m_s(t_s, x1_m[part]), asked_m_s

    def speed_settling(self, height_m_s: float) -> Figure:
        error = self._get("v2_m_s") - self._get("v2_cmd_m_s")
        noise_m_s = self._noise(error)
        band_m_s = max(SPEED_STEP_BAND * abs(height_m_s), NOISE_PEAK * noise_m_s)
        return self._time_in_band(error, band_m_s, f"{band_m_s:.3g} m/s")

    def overshoot(self, name: str, goal: str, height: float) -> Figure:
        """Largest excess of a signal over its goal in the direction of a step of `height`, in % of it."""
        error = self._get(name) - self._get(goal)
        excess = float(np.max(error * np.sign(height)))
        return Figure(100 * excess / abs(height) if excess > 0 and excess > NOISE_PEAK * self._noise(error) else 0.0)

    def _noise(self, error: Array) -> float:
        part = self._settled(error)
        if still_settling(self.t_s, error):
            raise _UnknownError(f"noise cannot be told from what still settles after the hold of {self.hold_s:.3g} s")
        return _trend_rms(self.t_s[part], error[part])

    def _time_in_band(self, error: Array, band: float, text: str) -> Figure:
        entered = _entered(error, band)
        if entered == len(error):
            return Figure(None, f"not within {text} for good in the hold of {self.hold_s:.3g} s", self.hold_s)
        time_s = float(self.t_s[entered] - self.t_s[0])
        needed_s = least_stay_s(self.hold_s)
        if self.hold_s - time_s < needed_s:
            stayed = f"within {text} for the last {self.hold_s - time_s:.2g} s of the hold only"
            raise _UnknownError(f"{stayed}, at least {needed_s:.2g} s are needed")
        return Figure(time_s)


def working_window(t_s: ArrayLike, v2_cmd_m_s: ArrayLike) -> slice | None:
    """Samples of the longest stretch (in time) in which the line-speed command is the run's largest, within 0.1 %.

    None if the line never ran.
    """
    time_s, command = np.asarray(t_s, np.float64), np.abs(np.asarray(v2_cmd_m_s, np.float64))
    finite = np.isfinite(command)
    top = np.max(command[finite], initial=0.0)
    if top == 0:
        return None
    inside = finite & (np.where(finite, command, 0) >= top * (1 - SPEED_BAND))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(np.int8), [0]))))
    starts, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(time_s[ends - 1] - time_s[starts]))
    return slice(int(starts[longest]), int(ends[longest]))


def last_step(E_true_Pa: ArrayLike) -> int | None:
    """Index of the first sample with the value after the last step of the true E; None if it never stepped.

    A ramp over some samples, each above `STEP_SHARE`, counts as one step that ends with it.
    """
    true = np.asarray(E_true_Pa, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.flatnonzero(np.abs(true[1:] / true[:-1] - 1) > STEP_SHARE)
    return int(steps[-1]) + 1 if len(steps) else None


def settled_part(t_s: ArrayLike, values: ArrayLike) -> slice:
    """The end of a stretch without its transient: at most the last `SETTLED_S`, at least the last `LEAST_SETTLED_S`.

    Where the transient ends is decided by the marginal standard error rule: cut off is what makes the standard error
    of the mean of the rest least, up to half of the stretch (White, An effective truncation heuristic for bias
    reduction in simulation output, Simulation 69(6), 1997).
    """
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    earliest = int(np.searchsorted(time_s, time_s[-1] - SETTLED_S))
    return slice(max(_truncation(data, _latest_cut(time_s)), earliest), None)


def _latest_cut(time_s: Array) -> int:
    return min(int(np.searchsorted(time_s, time_s[-1] - LEAST_SETTLED_S)), len(time_s) // 2)


def _truncation(data: Array, latest: int) -> int:
    """How many samples at the beginning to leave out, at most `latest`, for the least standard error of the mean."""
    backwards = (data - data[-1])[::-1]
    count = np.arange(1, len(data) + 1)
    squares = np.cumsum(backwards**2) - np.cumsum(backwards) ** 2 / count
    errors = (np.maximum(squares, 0.0) / count**2)[::-1]
    return int(np.argmin(errors[: latest + 1]))


def still_settling(t_s: ArrayLike, values: ArrayLike) -> bool:
    """Whether the settled part of a short stretch still has some of the transient: as much was cut off as may be, and
    the first third of the rest is far more uneven about its straight-line trend than the last.
    """
    time_s, data = np.asarray(t_s, np.float64), np.asarray(values, np.float64)
    latest, part = _latest_cut(time_s), settled_part(time_s, data)
    third = len(data[part]) // 3
    if third < 2 or part.start > latest or _truncation(data, latest) < _AT_THE_LIMIT * latest:
        return False
    first = _rms(_about_trend(time_s[part], data[part])[:third])
    last = _rms(_about_trend(time_s[-third:], data[-third:]))
    return first > _STILL_SETTLING * last + 1e-9 * float(np.max(np.abs(data)))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def least_stay_s(hold_s: float) -> float:
    """How long (s) a signal must have been in its band at the end of a hold to be called settled."""
    return min(LEAST_SETTLED_S, hold_s / 4)


def time_to_stay(t_s: ArrayLike, error: ArrayLike, band: float, start: int) -> float | None:
    """Time (s) from sample `start` until ``|error| <= band`` holds for every later sample.

    None if it does not hold in the end, or for less than `least_stay_s`. A sample that is no number is outside.
    """
    time_s, values = np.asarray(t_s, np.float64)[start:], np.asarray(error, np.float64)[start:]
    entered = _entered(values, band)
    if entered == len(time_s) or time_s[-1] - time_s[entered] < least_stay_s(float(time_s[-1] - time_s[0])):
        return None
    return float(time_s[entered] - time_s[0])


def _entered(error: Array, band: float) -> int:
    """The first sample from which on all are in the band; the length if the last one is not."""
    outside = np.flatnonzero(~(np.abs(error) <= band))
    return int(outside[-1]) + 1 if len(outside) else 0


def overshoot_pct(estimate_Pa: ArrayLike, E_true_Pa: ArrayLike, step: int) -> float | None:
    """Largest excess of the estimate beyond the true E, in the step's direction, as % of the step; noise included.

    The step is the difference between the true E at `step` and before the ramp of samples that led to it.
    """
    estimate, true = np.asarray(estimate_Pa, np.float64), np.asarray(E_true_Pa, np.float64)
    before = step - 1
    while before > 0 and abs(true[before] / true[before - 1] - 1) > STEP_SHARE:
        before -= 1
    height = true[step] - true[before]
    excess = 100 * np.max((estimate[step:] - true[step:]) / height)
    return None if np.isnan(excess) else max(0.0, float(excess))


def noise_pct(t_s: ArrayLike, estimate_Pa: ArrayLike, E_true_Pa: ArrayLike) -> float | None:
    """Rms of the estimate about its least-squares straight line over time, as % of the mean true E."""
    rms_Pa = _trend_rms(np.asarray(t_s, np.float64), np.asarray(estimate_Pa, np.float64))
    return _finite(100 * rms_Pa / float(np.mean(np.asarray(E_true_Pa, np.float64))))


def _trend_rms(time_s: Array, values: Array) -> float:
    return float(np.std(_about_trend(time_s, values)))


def _about_trend(time_s: Array, values: Array) -> Array:
    """What is left of values beside their least-squares straight line over time."""
    centred_s, centred = time_s - time_s.mean(), values - values.mean()
    spread = float(centred_s @ centred_s)
    slope = float(centred_s @ centred) / spread if spread else 0.0
    return np.asarray(centred - slope * centred_s, np.float64)


def mean_velocity_m_s(t_s: ArrayLike, x_m: ArrayLike) -> float:
    """Velocity as the least-squares slope of the encoder's position: far finer than the differentiated velocity."""
    time_s, position_m = np.asarray(t_s, np.float64), np.asarray(x_m, np.float64)
    centred_s = time_s - time_s.mean()
    return float(centred_s @ (position_m - position_m.mean()) / (centred_s @ centred_s))


def expected_v1_m_s(v2_m_s: Number, strain_prev: Number, strain: Number) -> Number:
    """Steady state of mass conservation in the span, v1/(1+ε_prev) = v2/(1+ε) (design 5); numbers or arrays."""
    return v2_m_s * (1 + strain_prev) / (1 + strain)


def _finite(value: float | np.floating[Any] | None) -> float | None:
    return float(value) if value is not None and np.isfinite(value) else None
