"""Synchronizers side by side on one recording: how fast, how quiet, how right, how honest, and how dear."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from hilbench.arrays import Array
from hilbench.errors import UnusableInputError
from hilbench.estimation.web_line.bound import least_deviation_Pa, torque_noise_Nm
from hilbench.estimation.web_line.config import METHODS, EstimationConfig, PidConfig, SynchronizerConfig, TransferConfig
from hilbench.estimation.web_line.measurements import Measurements
from hilbench.estimation.web_line.offline import Track, run_offline
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import Recording
from hilbench.runs import figures
from hilbench.topology.config import BenchConfig
from hilbench.topology.signal_kinds import TIME

#: Channels that a synchronizer is given.
NEEDED = ("v1_cmd_m_s", "v2_cmd_m_s", "x1_m", "x2_m", "tau2_Nm", "strain_prev", "F_next_N")
#: Time after a step of E from which the estimate counts as settled, s, where the recording is long enough for it.
SETTLED_AFTER_S = 1.0
#: Samples that a noise about a line, a bias and a share need at least.
_LEAST_SETTLED = 3
#: Two-sided 95 % of a normal distribution, in standard deviations.
INTERVAL = 1.96


@dataclass(frozen=True, slots=True)
class MethodResult:
    """One method on one recording. What needs the true E, or a step of it, is None where there is none."""

    method: str
    track: Track
    time_to_1pct_s: float | None
    overshoot_pct: float | None
    noise_pct: float | None  #: rms about its trend, settled part
    bias_pct: float | None  #: mean error, settled part
    largest_error_pct: float | None  #: settled part
    covered: float | None  #: share of settled cycles in which ±1.96 stated deviations hold the true E
    cpu_us: float | None  #: per cycle, balance and transfer included; None: it ran beside a bench

    @property
    def final_E_Pa(self) -> float:
        """The last estimate."""
        return float(self.track.E_Pa[-1])

    @property
    def final_sd_Pa(self) -> float:
        """The deviation that the method states for it."""
        return float(self.track.E_sd_Pa[-1])


@dataclass(frozen=True, slots=True)
class Comparison:
    """Methods on one recording, and the bound no method can beat."""

    t_s: Array
    E_true_Pa: Array | None
    step_s: float | None  #: time of the last step of the true E
    noise_Nm: float  #: of the torque measurement, as the recording shows it
    bound_sd_Pa: Array  #: since the last step (or the start), (n,), infinite before
    bound_time_to_1pct_s: float | None  #: until two deviations of the bound are within 1 %
    results: list[MethodResult]


def methods_of(text: str) -> dict[str, SynchronizerConfig]:
    """The methods of a comma-separated list with their default settings; ``all`` is all of them.

    Raises UnusableInputError for an unknown one.
    """
    names = list(METHODS) if text.strip() == "all" else [name.strip() for name in text.split(",") if name.strip()]
    unknown = next((name for name in names if name not in METHODS), None if names else text)
    if unknown is not None:
        raise UnusableInputError("--method", f"'{unknown}', expected some of {', '.join(METHODS)}, or all")
    return {name: METHODS[name]() for name in names}


def require_one_span(model: ModelParameters, place: str | Path) -> None:
    """Raise UnusableInputError for a line of other than two rollers: what is compared here is of one span."""
    if model.axis_count != 2:
        raise UnusableInputError(place, f"a line of {model.axis_count} rollers, expected one of two, with one span")


def measurements_of(recording: Recording, place: str | Path) -> Measurements:
    """Measurements that a twin would have received. Raises UnusableInputError when a channel is missing."""
    recording.require(NEEDED, place)

    def channel(name: str) -> Array:
        return np.asarray(recording[name], np.float64)

    return Measurements(
        t_s=recording.time_s,
        v_cmd_m_s=np.column_stack([channel("v1_cmd_m_s"), channel("v2_cmd_m_s")]),
        x_m=np.column_stack([channel("x1_m"), channel("x2_m")]),
        tau2_Nm=channel("tau2_Nm"),
        strain_prev=channel("strain_prev"),
        F_next_N=channel("F_next_N"),
    )


def twin_config(method: SynchronizerConfig, unmodelled_torque_Nm: float | None = None) -> EstimationConfig:
    """A twin with this method; the published one transfers no state, as it was published. None: the default."""
    transfer = TransferConfig(strain=not isinstance(method, PidConfig))
    if unmodelled_torque_Nm is None:
        return EstimationConfig(estimate=[method], transfer=transfer)
    return EstimationConfig(estimate=[method], transfer=transfer, unmodelled_torque_Nm=unmodelled_torque_Nm)


def compare_methods(
    model: ModelParameters,
    data: Measurements,
    methods: Mapping[str, SynchronizerConfig],
    E_true_Pa: Array | None = None,
    unmodelled_torque_Nm: float | None = None,
) -> Comparison:
    """Run each method (by the name it is shown under) over the recording and score it.

    `unmodelled_torque_Nm` as in `EstimationConfig`; None: its default.

    The first second of a recording, while a twin settles, is not scored. Raises ValueError for a model without drives
    or of other than two rollers, and for a sampling period that is no multiple of the drives'.
    """
    tracks = {
        name: run_offline(model, twin_config(method, unmodelled_torque_Nm), data) for name, method in methods.items()
    }
    return _comparison(model, data, E_true_Pa, tracks)


#: What a run shows of its synchronizer, and what the bound of its samples needs.
_SHOWN = ("E_sim_Pa", "E_sd_Pa", "F_sim_N", "tau2_residual_Nm", "E_true_Pa")


def compare_runs(model: ModelParameters, runs: Mapping[str, Recording]) -> Comparison:
    """Score the synchronizers as they ran on a bench, each in a run of its own (recordings by method).

    The runs are of one experiment; where one went on for longer its end is left out. The bound is that of the first
    run's samples. Raises UnusableInputError when a channel is missing, or the runs are of different experiments.
    """
    length = min(len(recording) for recording in runs.values())
    for name, recording in runs.items():
        recording.require(_SHOWN, name)
    first = measurements_of(next(iter(runs.values())), next(iter(runs)))
    data = Measurements(**{each.name: getattr(first, each.name)[:length] for each in fields(Measurements)})
    true = np.asarray(next(iter(runs.values()))["E_true_Pa"], np.float64)[:length]
    tracks = {}
    for name, recording in runs.items():
        shown = [np.asarray(recording[channel], np.float64)[:length] for channel in _SHOWN]
        if not np.array_equal(shown[-1], true):
            raise UnusableInputError(name, "E changes otherwise than in the other runs, expected one experiment")
        modulus, deviation, tension, residual, _ = shown
        tracks[name] = Track(modulus, deviation, tension, residual, nuisances={}, synchronizer_us=None)
    return _comparison(model, data, true, tracks)


def _comparison(
    model: ModelParameters, data: Measurements, E_true_Pa: Array | None, tracks: Mapping[str, Track]
) -> Comparison:
    """Scores of each method, and the bound of these samples."""
    step = figures.last_step(E_true_Pa) if E_true_Pa is not None else None
    noise_Nm = torque_noise_Nm(data)
    bound = np.full(len(data.t_s), np.inf)
    bound[step or 0 :] = least_deviation_Pa(model, data, step or 0, noise_Nm)
    return Comparison(
        t_s=data.t_s,
        E_true_Pa=E_true_Pa,
        step_s=float(data.t_s[step]) if step is not None else None,
        noise_Nm=noise_Nm,
        bound_sd_Pa=bound,
        bound_time_to_1pct_s=_bound_time_s(data.t_s, bound, E_true_Pa, step),
        results=[_score(name, track, data.t_s, E_true_Pa, step) for name, track in tracks.items()],
    )


def _bound_time_s(t_s: Array, bound_Pa: Array, E_true_Pa: Array | None, step: int | None) -> float | None:
    if E_true_Pa is None or step is None:
        return None
    within = 2.0 * bound_Pa[step:] <= figures.ESTIMATE_BAND * E_true_Pa[step:]
    return float(t_s[step + int(np.argmax(within))] - t_s[step]) if within.any() else None


def _score(method: str, track: Track, t_s: Array, true: Array | None, step: int | None) -> MethodResult:
    if true is None:
        return MethodResult(method, track, None, None, None, None, None, None, track.synchronizer_us)
    error = track.E_Pa / true - 1.0
    start = int(np.searchsorted(t_s, (t_s[step] if step is not None else t_s[0]) + SETTLED_AFTER_S))
    settled = slice(start, None)
    shown = len(t_s) - start >= _LEAST_SETTLED
    inside = np.abs(track.E_Pa - true) <= INTERVAL * track.E_sd_Pa
    return MethodResult(
        method=method,
        track=track,
        time_to_1pct_s=figures.time_to_stay(t_s, error, figures.ESTIMATE_BAND, step) if step is not None else None,
        overshoot_pct=figures.overshoot_pct(track.E_Pa, true, step) if step is not None else None,
        noise_pct=figures.noise_pct(t_s[settled], track.E_Pa[settled], true[settled]) if shown else None,
        bias_pct=100.0 * float(np.mean(error[settled])) if shown else None,
        largest_error_pct=100.0 * float(np.max(np.abs(error[settled]))) if shown else None,
        covered=float(np.mean(inside[settled])) if shown else None,
        cpu_us=track.synchronizer_us,
    )


def estimates(comparison: Comparison) -> Recording:
    """Estimates of all methods over time: `t_s`, then `METHOD_E_Pa` and its standard deviation `METHOD_E_sd_Pa`.

    A row for each one of the recording, in Pa; a deviation that a method can't state is infinite.
    """
    channels = {TIME: comparison.t_s}
    for result in comparison.results:
        channels[f"{result.method}_E_Pa"] = result.track.E_Pa
        channels[f"{result.method}_E_sd_Pa"] = result.track.E_sd_Pa
    return Recording(channels)


def reference_estimate(config: BenchConfig, recording: Recording) -> Array | None:
    """E as the published method would have tracked it in this run; None where the run used it, or signals are missing.

    The tension loop was closed on another twin's tension then, which is the same for both.
    """
    if isinstance(config.twin.synchronizer, PidConfig) or any(name not in recording for name in NEEDED):
        return None
    data = measurements_of(recording, "recording")
    return run_offline(config.web_line, twin_config(PidConfig()), data).E_Pa
