"""What a run is judged by: pure functions on recorded arrays.

Arrays are one-dimensional and share one time base `t_s` (s, strictly increasing). A metric is evaluated in the
run's *window*: the longest stretch in which the line runs at its working speed (`working_window`), without the ramps.
The *last step* is the last jump of the true E in the window; the *settled part* is the end of the window, after the
last step (`settled_part`). A metric that a run cannot have (no step in it, no truth recorded, never settled) is None;
nothing is put in its place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Number = TypeVar("Number", float, Array)
Channels = Mapping[str, NDArray[Any]]

#: Share of the working speed by which the command may differ from it inside the window.
SPEED_BAND: Final = 1e-3
#: A true E that changes by more than this share from one sample to the next has stepped; slower is drift.
STEP_SHARE: Final = 1e-3
#: Length of the settled part, s, and the least that still counts as one.
SETTLED_S: Final = 5.0
LEAST_SETTLED_S: Final = 1.0
#: Half width of the band the estimate has to enter, as a share of the true E.
E_BAND: Final = 0.01
#: Half width of the band the tension has to come back to, N.
TENSION_BAND_N: Final = 1.0


@dataclass(frozen=True)
class Metric:
    """What a metric's number means: its unit, and why a run may not have it."""

    unit: str
    description: str
    absent: str


_NO_STEP = "E did not step, or the window ends before the value shows"
_NOT_SHOWN = "no step of E in the window, or the band was not reached for good"
_NO_WINDOW = "no working window, or signals that it needs are not recorded"
_NO_TIMING = "the timing was not measured"
_NOT_COUNTED = "this bus interface does not count them, or no cycle ran"

_OF_THE_CYCLE = (_NO_TIMING, _NOT_COUNTED)

METRICS: Final[dict[str, Metric]] = {
    "E_time_to_1pct_s": Metric("s", "time from the last step of E until the estimate stays within 1 %", _NOT_SHOWN),
    "E_final_error_pct": Metric("%", "size of the mean relative error of the estimate, settled part", _NO_WINDOW),
    "E_noise_pct": Metric("%", "rms of the estimate about its straight-line trend, settled part", _NO_WINDOW),
    "E_overshoot_pct": Metric("%", "largest excess of the estimate over the new E, share of the step", _NO_STEP),
    "tension_recovery_s": Metric("s", "time from the last step of E until the true tension stays in band", _NOT_SHOWN),
    "tension_rms_error_N": Metric("N", "rms of true tension minus set-point since the last step", _NO_WINDOW),
    "tension_peak_error_N": Metric("N", "largest true tension error since the last step", _NO_WINDOW),
    "tension_final_error_N": Metric("N", "size of the mean true tension error, settled part", _NO_WINDOW),
    "tension_sim_deviation_N": Metric("N", "largest simulated tension error since the last step", _NO_WINDOW),
    "v1_final_m_s": Metric("m/s", "mean velocity of roller 1, settled part", _NO_WINDOW),
    "v1_expected_m_s": Metric("m/s", "v2·(1+ε_prev)/(1+ε), what mass conservation asks of v1", _NO_WINDOW),
    "v1_deviation_m_s": Metric("m/s", "v1_final_m_s minus v1_expected_m_s", _NO_WINDOW),
    "cycles_missed": Metric("", "cycles whose deadline passed", _NO_TIMING),
    "jitter_p99_us": Metric("µs", "99th percentile of the lateness of SYNC", _NO_TIMING),
    "jitter_max_us": Metric("µs", "largest lateness of SYNC", _NO_TIMING),
    "realtime_factor": Metric("", "bus time over wall time", _NO_TIMING),
    "lost_frames": Metric("", "frames that reached the interface of the bench and were not read in time", _NOT_COUNTED),
    "bus_load_pct": Metric("%", "bits on the bus over its capacity", _NO_TIMING),
}


def evaluate_metrics(channels: Channels, *, tension_band_N: float = TENSION_BAND_N) -> dict[str, float | None]:
    """All metrics of a recording that its arrays decide (the timing's come from the cycle, not from here).

    `channels` are named as in `hilbench.bench.signals`, of equal length; which are missing decides which metrics
    are None.
    """
    results: dict[str, float | None] = dict.fromkeys(
        name for name in METRICS if METRICS[name].absent not in _OF_THE_CYCLE
    )
    span = working_window(channels["t_s"], channels["v2_cmd_m_s"]) if "v2_cmd_m_s" in channels else None
    if span is None:
        return results
    cut = {name: np.asarray(values[span], np.float64) for name, values in channels.items()}
    step = last_step(cut["E_true_Pa"]) if "E_true_Pa" in cut else None
    settled = settled_part(cut["t_s"], step)
    results |= _elasticity(cut, step, settled)
    results |= _tension(cut, step, settled, tension_band_N)
    results |= _velocity(cut, settled)
    return results


def _elasticity(cut: Mapping[str, Array], step: int | None, settled: slice | None) -> dict[str, float | None]:
    if not {"E_sim_Pa", "E_true_Pa"} <= cut.keys():
        return {}
    t_s, estimate, true = cut["t_s"], cut["E_sim_Pa"], cut["E_true_Pa"]
    found: dict[str, float | None] = {}
    if step is not None:
        found["E_time_to_1pct_s"] = time_to_stay(t_s, estimate / true - 1, E_BAND, step)
        found["E_overshoot_pct"] = overshoot_pct(estimate, true, step)
    if settled is not None:
        found["E_final_error_pct"] = _size(100 * np.mean(estimate[settled] / true[settled] - 1))
        found["E_noise_pct"] = noise_pct(t_s[settled], estimate[settled], true[settled])
    return found


def _tension(
    cut: Mapping[str, Array], step: int | None, settled: slice | None, band_N: float
) -> dict[str, float | None]:
    found: dict[str, float | None] = {}
    if "F_ref_N" not in cut:
        return found
    since = slice(step or 0, None)
    if "F_true_N" in cut:
        error_N = cut["F_true_N"] - cut["F_ref_N"]
        if step is not None:
            found["tension_recovery_s"] = time_to_stay(cut["t_s"], error_N, band_N, step)
        found["tension_rms_error_N"] = _finite(np.sqrt(np.mean(error_N[since] ** 2)))
        found["tension_peak_error_N"] = _size(np.max(np.abs(error_N[since])))
        if settled is not None:
            found["tension_final_error_N"] = _size(np.mean(error_N[settled]))
    if "F_sim_N" in cut:
        found["tension_sim_deviation_N"] = _size(np.max(np.abs(cut["F_sim_N"] - cut["F_ref_N"])[since]))
    return found


def _velocity(cut: Mapping[str, Array], settled: slice | None) -> dict[str, float | None]:
    if settled is None or not {"x1_m", "x2_m", "strain_prev", "strain_true"} <= cut.keys():
        return {}
    t_s = cut["t_s"][settled]
    v1_m_s = mean_velocity_m_s(t_s, cut["x1_m"][settled])
    v2_m_s = mean_velocity_m_s(t_s, cut["x2_m"][settled])
    strain_prev, strain = float(np.mean(cut["strain_prev"][settled])), float(np.mean(cut["strain_true"][settled]))
    expected_m_s = expected_v1_m_s(v2_m_s, strain_prev, strain)
    return {
        "v1_final_m_s": _finite(v1_m_s),
        "v1_expected_m_s": _finite(expected_m_s),
        "v1_deviation_m_s": _finite(v1_m_s - expected_m_s),
    }


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


def step_times_s(t_s: ArrayLike, E_true_Pa: ArrayLike) -> list[tuple[float, float]]:
    """Every step of the true E: its time (s) and its relative change; a ramp over some samples is one step."""
    time_s, true = np.asarray(t_s, np.float64), np.asarray(E_true_Pa, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.flatnonzero(np.abs(true[1:] / true[:-1] - 1) > STEP_SHARE) + 1
    groups = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1) if len(steps) else []
    return [(float(time_s[group[-1]]), float(true[group[-1]] / true[group[0] - 1] - 1)) for group in groups]


def settled_part(t_s: ArrayLike, step: int | None) -> slice | None:
    """The last `SETTLED_S` of the window, or less where it begins with the step; None below `LEAST_SETTLED_S`."""
    time_s = np.asarray(t_s, np.float64)
    start = max(int(np.searchsorted(time_s, time_s[-1] - SETTLED_S)), step or 0)
    return slice(start, None) if time_s[-1] - time_s[start] >= LEAST_SETTLED_S else None


def time_to_stay(t_s: ArrayLike, error: ArrayLike, band: float, start: int) -> float | None:
    """Time (s) from sample `start` until ``|error| <= band`` holds for every later sample.

    None if it does not hold in the end, or for less than `LEAST_SETTLED_S`. A sample that is no number is outside.
    """
    time_s, inside = np.asarray(t_s, np.float64)[start:], np.abs(np.asarray(error, np.float64)[start:]) <= band
    outside = np.flatnonzero(~inside)
    entered = int(outside[-1]) + 1 if len(outside) else 0
    if entered == len(time_s) or time_s[-1] - time_s[entered] < LEAST_SETTLED_S:
        return None
    return float(time_s[entered] - time_s[0])


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
    time_s, estimate = np.asarray(t_s, np.float64), np.asarray(estimate_Pa, np.float64)
    centred_s, centred = time_s - time_s.mean(), estimate - estimate.mean()
    slope = float(centred_s @ centred) / float(centred_s @ centred_s)
    rms_Pa = float(np.std(centred - slope * centred_s))
    return _finite(100 * rms_Pa / float(np.mean(np.asarray(E_true_Pa, np.float64))))


def mean_velocity_m_s(t_s: ArrayLike, x_m: ArrayLike) -> float:
    """Velocity as the least-squares slope of the encoder's position: far finer than the differentiated velocity."""
    time_s, position_m = np.asarray(t_s, np.float64), np.asarray(x_m, np.float64)
    centred_s = time_s - time_s.mean()
    return float(centred_s @ (position_m - position_m.mean()) / (centred_s @ centred_s))


def expected_v1_m_s(v2_m_s: Number, strain_prev: Number, strain: Number) -> Number:
    """Steady state of mass conservation in the span, v1/(1+ε_prev) = v2/(1+ε) (design 5); numbers or arrays."""
    return v2_m_s * (1 + strain_prev) / (1 + strain)


def _finite(value: float | np.floating[Any]) -> float | None:
    return float(value) if np.isfinite(value) else None


def _size(value: float | np.floating[Any]) -> float | None:
    return _finite(abs(float(value)))
