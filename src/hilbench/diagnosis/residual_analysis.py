"""Dependences of residuals: binned over states, as peaks over frequency and angle, as bursts in time.

Residuals are scaled by the noise floor, so that under noise alone each statistic is chi-square; `excess` is what it has
beyond its degrees of freedom. A misfit is significant when the excess is beyond what the many looks bring by chance.

How often that is right: tools/diagnose_scoreboard.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis.noise import rms

_BINS: Final = 12
_ANGLE_BINS: Final = 24
#: Standard deviations of a binned statistic, and a constant, from which it is significant.
_ERRORS, _LEAST = 6.0, 15.0
#: Height of a spectral peak above the expected largest one (2·ln of their number).
_PEAK: Final = 24.0
#: Share of a lasting change's sum of squares that may lie before it: what other effects leave there.
_BEFORE: Final = 0.05
#: Mean over noise of the blocks of a lasting change: with half of it one in 30 000 blocks is taken for its end.
_OF_BLOCK: Final = 8.0
#: Least rows of such a block, so that a change that grows is seen from its beginning: a tenth of its end, of 10 floors.
_LEAST_ROWS: Final = 16
#: Length of a window in which a burst is looked for, s, and its size in standard deviations.
_WINDOW_S, _BURST = 0.5, 7.0
#: Rms over the floor from which more than noise is left even if no condition explains it, and standard errors from
#: which it is where there are few rows.
_LARGEST_RATIO, _RMS_ERRORS = 1.05, 3.0
#: Variance of a floor, which comes of fourth differences (`noise.floor`), in that of an rms of as many rows:
#: 1 + 2·Σρ², with their correlations ρ = 56, 28, 8, 1 in 70.
_OF_FLOOR: Final = 1.0 + 2.0 * (56.0**2 + 28.0**2 + 8.0**2 + 1.0) / 70.0**2
#: Times what a signal that is no torque is believed to from which its prediction is wrong.
_MOST_BEYOND_NOISE: Final = 2.0
#: Highest frequency in Hz, or order of a turn, of a peak; the lowest order (what takes more than two turns does not
#: come from the turning); and the lowest of both in cycles over the recording.
_HIGHEST: Final = 64.0
_LEAST_ORDER: Final = 0.5
_LEAST_CYCLES: Final = 4.0
#: Bins of a state narrower than this share of its range are none.
_NARROWEST: Final = 1e-6


@dataclass(frozen=True)
class Condition:
    """A state that residuals are looked at against; `period` for angles (in its unit)."""

    name: str
    unit: str
    values: Array  #: (n,)
    period: float | None = None
    spectral: bool = False


def of_motion(t_s: Array, axis: int, unit: str, speed: Array, acceleration: Array) -> list[Condition]:
    """Time, and motion (n,) of an axis whose position is in `unit`."""
    return [
        Condition("time", "s", t_s, spectral=True),
        Condition(f"speed of axis {axis}", f"{unit}/s", speed),
        Condition(f"acceleration of axis {axis}", f"{unit}/s²", acceleration),
    ]


@dataclass(frozen=True)
class Misfit:
    """A dependence that was found."""

    signal: str
    condition: str
    detail: str
    excess: float
    threshold: float
    when: str
    points: tuple[tuple[float, float], ...] = ()  #: of a binned one: centre (in `unit`), mean residual in floors
    unit: str = ""
    shape: Array | None = field(default=None, repr=False, compare=False)  #: (n,) what it explains of the residual

    @property
    def significant(self) -> bool:
        """Beyond chance."""
        return self.excess > self.threshold


def misfits(
    names: tuple[str, ...], scaled: Array, rows: NDArray[np.bool_], conditions: list[Condition]
) -> list[Misfit]:
    """Dependences of residuals (signals, n) that were looked at, largest excess first."""
    found = []
    for k, name in enumerate(names):
        for condition in conditions:
            found.append(_binned(name, scaled[k], rows, condition))
            if condition.spectral:
                found.append(_peak(name, scaled[k], rows, condition))
        found.append(_burst(name, scaled[k], rows, conditions[0]))
    return sorted(found, key=lambda m: m.threshold - m.excess)


def located(
    names: tuple[str, ...], scaled: Array, rows: NDArray[np.bool_], conditions: list[Condition], most: int
) -> list[tuple[Misfit, float]]:
    """Locate residuals (signals, n), with the share of all that is beyond noise; at most `most`, largest first.

    Conditions go together (time, speed, tension): what the first explains is taken out before the next is looked for,
    so that the shares are parts of one whole.
    """
    residual = scaled.copy()
    counted = float(np.count_nonzero(rows))
    whole = float(np.sum(np.maximum(np.sum(scaled[:, rows] ** 2, axis=1) - counted, 0.0)))
    found: list[tuple[Misfit, float]] = []
    while len(found) < most:
        best = max(misfits(names, residual, rows, conditions), key=lambda m: m.excess if m.significant else 0.0)
        if not best.significant or best.shape is None:
            break
        signal = names.index(best.signal)
        before = float(np.sum(residual[signal, rows] ** 2))
        residual[signal] -= best.shape
        found.append((best, max(before - float(np.sum(residual[signal, rows] ** 2)), 0.0) / max(whole, 1e-300)))
    total = sum(share for _, share in found)
    return [(m, share / max(total, 1.0)) for m, share in found]


def _binned(name: str, values: Array, rows: NDArray[np.bool_], condition: Condition) -> Misfit:
    at, r = condition.values[rows], values[rows]
    if condition.period is not None:
        at = np.mod(at, condition.period)
        edges = np.linspace(0.0, condition.period, _ANGLE_BINS + 1)
    else:
        edges = np.quantile(at, np.linspace(0.0, 1.0, _BINS + 1))
        wide = np.diff(edges) > _NARROWEST * max(float(np.max(np.abs(at))), 1e-300)
        edges = np.concatenate([edges[:1], edges[1:][wide]])
        if len(edges) < 2:
            return Misfit(name, condition.name, "", 0.0, 1.0, "always")
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1).astype(float)
    mean = np.bincount(place, weights=r, minlength=len(edges) - 1) / np.maximum(count, 1.0)
    part = count * mean**2
    bins = float(np.count_nonzero(count))
    worst = int(np.argmax(part))
    detail = f"largest at {_interval(float(edges[worst]), float(edges[worst + 1]))} {condition.unit}"
    if condition.name == "time" and (onset := _onset(at, r, edges, mean, count)) is not None:
        detail = f"from {onset:.4g} {condition.unit} on"
    centres = 0.5 * (edges[:-1] + edges[1:])
    points = tuple((float(c), float(m)) for c, m, n in zip(centres, mean, count, strict=True) if n)
    threshold = _ERRORS * float(np.sqrt(2.0 * bins)) + _LEAST
    shape = np.zeros(len(values))
    shape[rows] = mean[place]
    excess = float(part.sum()) - bins
    return Misfit(name, condition.name, detail, excess, threshold, "always", points, condition.unit, shape)


def _onset(t_s: Array, r: Array, edges: Array, mean: Array, count: Array) -> float | None:
    """Time, s, of a change that lasts to the end, by residuals r (n,) in floors, and by bins; None: there is none.

    It lasts where the mean of short blocks has one sign to the end, so long that their noise is `_OF_BLOCK` times
    smaller than the median of the bins in its second half; the bins before it, one at least, hold less than `_BEFORE`
    of the bins' sum of squares.
    """
    level = float(np.median(mean[len(mean) // 2 :]))
    rows = max(int(np.ceil((_OF_BLOCK / max(abs(level), 1e-9)) ** 2)), _LEAST_ROWS)
    blocks = len(r) // rows
    if not blocks:
        return None
    means = r[len(r) - blocks * rows :].reshape(blocks, rows).mean(axis=1) * np.sign(level)
    below = np.flatnonzero(means * np.sqrt(rows) < 0.5 * _OF_BLOCK)
    begin = len(r) - (blocks - (below[-1] + 1 if len(below) else 0)) * rows
    if begin == len(r):
        return None
    bins, part = int(np.searchsorted(edges, t_s[begin], side="right")) - 1, count * mean**2  # bins before it
    return float(t_s[begin]) if bins > 0 and part[:bins].sum() < _BEFORE * part.sum() else None


def _interval(low: float, high: float) -> str:
    """Both ends, with as many digits as distinguish them."""
    for digits in range(3, 10):
        ends = f"{low:.{digits}g}", f"{high:.{digits}g}"
        if ends[0] != ends[1]:
            break
    return " to ".join(ends)


def _peak(name: str, values: Array, rows: NDArray[np.bool_], condition: Condition) -> Misfit:
    period = condition.period or 1.0
    at, r = condition.values[rows] / period, values[rows]
    start, total = float(at.min()), float(np.ptp(at))
    highest = min(_HIGHEST, 0.4 * len(r) / max(total, 1e-9))
    order, power = spectrum_over(at, r[None], highest)
    power = 2.0 * power / len(r)
    least = _LEAST_CYCLES / max(total, 1e-9) if condition.period is None else _LEAST_ORDER
    power[(order < max(least, _LEAST_CYCLES / max(total, 1e-9))) | (order > highest)] = 0.0
    count = max(float(np.count_nonzero(power)), 2.0)
    best = int(np.argmax(power))
    what = f"order {order[best]:.4g} of a turn" if condition.period is not None else f"{order[best]:.4g} Hz"
    label = "frequency" if condition.period is None else f"order of {condition.name}"
    wave = np.exp(2j * np.pi * order[best] * (at - start))
    shape = np.zeros(len(values))
    shape[rows] = 2.0 * np.real(wave * np.mean(r * np.conj(wave)))
    return Misfit(name, label, what, float(power[best]), 2.0 * float(np.log(count)) + _PEAK, "always", shape=shape)


def spectrum_over(at: Array, values: Array, highest: float) -> tuple[Array, Array]:
    """Orders up to beyond the highest, in cycles of the unit of an angle or time (n,), and the power of values
    (signals, n) at each; powers of the signals add.

    Values are summed in bins of the angle, whose Fourier transform is their correlation with every order at once.
    """
    total = max(float(np.ptp(at)), 1e-9)
    bins = 1 << int(np.ceil(np.log2(max(4.0 * highest * total, 16.0))))
    place = np.minimum(((at - float(at.min())) / total * bins).astype(int), bins - 1)
    power = np.zeros(bins // 2 + 1)
    for each in values:
        power += np.abs(np.fft.rfft(np.bincount(place, weights=each, minlength=bins))) ** 2
    return np.arange(len(power)) / total, power


def _burst(name: str, values: Array, rows: NDArray[np.bool_], time: Condition) -> Misfit:
    t = time.values
    window = np.floor(t / _WINDOW_S).astype(int)
    count = np.bincount(window[rows]).astype(float)
    energy = np.bincount(window[rows], weights=values[rows] ** 2)
    typical = float(np.sum(energy) / max(np.sum(count), 1.0))
    usable = count > 10.0
    z = np.where(usable, (energy - typical * count) / np.sqrt(2.0 * np.maximum(count, 1.0)), 0.0)
    worst = int(np.argmax(z))
    loud = np.flatnonzero(z > _BURST)
    when = f"t = {worst * _WINDOW_S:.1f} to {(worst + 1) * _WINDOW_S:.1f} s" + (
        f" and {len(loud) - 1} more times" if len(loud) > 1 else ""
    )
    excess = float(z[worst] * np.sqrt(2.0 * max(count[worst], 1.0)))
    threshold = _BURST * float(np.sqrt(2.0 * max(count[worst], 1.0)))
    shape = np.where(rows & np.isin(window, loud), values, 0.0)
    return Misfit(name, "burst in time", when, excess, threshold, when, shape=shape)


def largest_ratio(rows: NDArray[np.bool_]) -> float:
    """Largest ratio of the rms of a signal's residual on these rows (n,) to its floor that noise alone may cause."""
    count = max(int(np.count_nonzero(rows)), 1)
    return max(_LARGEST_RATIO, 1.0 + _RMS_ERRORS * float(np.sqrt((1.0 + _OF_FLOOR) / (2.0 * count))))


def beyond_noise(
    names: Sequence[str], residual: Array, rows: NDArray[np.bool_], believed: Array, signals: Sequence[int]
) -> list[Misfit]:
    """Signals, by their numbers, whose residual (signals, n) is more than they are believed to (signals,), as an rms.

    believed: standard deviation of their noise, and of what a right prediction may be off by; in the signals' units.
    """
    found = []
    for k in signals:
        left = rms(residual[k, rows])
        ratio = left / max(float(believed[k]), 1e-300)
        detail = f"rms {left:.2g}, {ratio:.2g} times what it is known to"
        found.append(Misfit(names[k], "in all", detail, ratio, _MOST_BEYOND_NOISE, "always"))
    return [one for one in found if one.significant]


def exceeds_noise(residual: Array, rows: NDArray[np.bool_], floors: Mapping[int, float]) -> bool:
    """True if the rms of residuals (signals, n) is more than noise alone makes of it, by signal."""
    return any(rms(residual[k, rows]) / floor > largest_ratio(rows) for k, floor in floors.items())


def in_floors(names: Sequence[str], residual: Array, floors: Mapping[int, float]) -> tuple[tuple[str, ...], Array]:
    """Names and residuals (signals, n) of those signals that have a floor, in their floors."""
    return tuple(names[k] for k in floors), residual[list(floors)] / np.array([*floors.values()])[:, None]
