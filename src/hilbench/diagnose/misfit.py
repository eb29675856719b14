"""What residuals still depend on: binned over states, as peaks over frequency and angle, as bursts in time.

Residuals are scaled by the noise floor, so that under noise alone each statistic is chi-square; `excess` is what it has
beyond its degrees of freedom. A misfit is significant when the excess is beyond what the many looks bring by chance.

How often that is right: tools/diagnose_scoreboard.py, docs/diagnosis.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BINS: Final = 12
_ANGLE_BINS: Final = 24
#: Standard deviations of a binned statistic, and a constant, from which it is significant.
_ERRORS, _LEAST = 6.0, 15.0
#: Height of a spectral peak above the expected largest one (2·ln of their number).
_PEAK: Final = 24.0
#: Length of a window in which a burst is looked for, s, and its size in standard deviations.
_WINDOW_S, _BURST = 0.5, 7.0
#: Excess of the rms over the floor that counts even if no condition explains it.
LARGEST_RATIO: Final = 1.05
#: A fundamental and so many multiples are one peak.
_HIGHEST: Final = 64.0


@dataclass(frozen=True)
class Condition:
    """A state that residuals are looked at against; `period` for angles (in its unit)."""

    name: str
    unit: str
    values: Array  #: (n,)
    period: float | None = None
    spectral: bool = False


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

    @property
    def significant(self) -> bool:
        """Beyond chance."""
        return self.excess > self.threshold


def misfits(
    names: tuple[str, ...], scaled: Array, rows: NDArray[np.bool_], conditions: list[Condition]
) -> list[Misfit]:
    """All dependences of residuals (signals, n) that were looked at, largest excess first."""
    found = []
    for k, name in enumerate(names):
        for condition in conditions:
            found.append(_binned(name, scaled[k], rows, condition))
            if condition.spectral:
                found.append(_peak(name, scaled[k], rows, condition))
        found.append(_burst(name, scaled[k], rows, conditions[0]))
    return sorted(found, key=lambda m: m.threshold - m.excess)


def _binned(name: str, values: Array, rows: NDArray[np.bool_], condition: Condition) -> Misfit:
    at, r = condition.values[rows], values[rows]
    if condition.period is not None:
        at = np.mod(at, condition.period)
        edges = np.linspace(0.0, condition.period, _ANGLE_BINS + 1)
    else:
        edges = np.unique(np.quantile(at, np.linspace(0.0, 1.0, _BINS + 1)))
        if len(edges) < 2:
            return Misfit(name, condition.name, "", 0.0, 1.0, "always")
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1).astype(float)
    mean = np.bincount(place, weights=r, minlength=len(edges) - 1) / np.maximum(count, 1.0)
    part = count * mean**2
    bins = float(np.count_nonzero(count))
    worst = int(np.argmax(part))
    detail = f"largest at {edges[worst]:.3g} to {edges[worst + 1]:.3g} {condition.unit}"
    centres = 0.5 * (edges[:-1] + edges[1:])
    points = tuple((float(c), float(m)) for c, m, n in zip(centres, mean, count, strict=True) if n)
    threshold = _ERRORS * float(np.sqrt(2.0 * bins)) + _LEAST
    return Misfit(name, condition.name, detail, float(part.sum()) - bins, threshold, "always", points, condition.unit)


def _peak(name: str, values: Array, rows: NDArray[np.bool_], condition: Condition) -> Misfit:
    period = condition.period or 1.0
    at, r = condition.values[rows] / period, values[rows]
    start, total = float(at.min()), float(np.ptp(at))
    highest = min(_HIGHEST, 0.4 * len(r) / max(total, 1e-9))
    bins = 1 << int(np.ceil(np.log2(max(4.0 * highest * total, 16.0))))
    place = np.minimum(((at - start) / max(total, 1e-9) * bins).astype(int), bins - 1)
    power = 2.0 * np.abs(np.fft.rfft(np.bincount(place, weights=r, minlength=bins))) ** 2 / len(r)
    order = np.arange(len(power)) / max(total, 1e-9)
    power[(order < 4.0 / max(total, 1e-9)) | (order > highest)] = 0.0
    count = max(float(np.count_nonzero(power)), 2.0)
    best = int(np.argmax(power))
    what = f"order {order[best]:.4g} of a turn" if condition.period is not None else f"{order[best]:.4g} Hz"
    label = "frequency" if condition.period is None else f"order of {condition.name}"
    return Misfit(name, label, what, float(power[best]), 2.0 * float(np.log(count)) + _PEAK, "always")


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
    return Misfit(name, "burst in time", when, excess, _BURST * float(np.sqrt(2.0 * max(count[worst], 1.0))), when)


def ratios(residual: Array, rows: NDArray[np.bool_], floors: Mapping[int, float]) -> dict[int, float]:
    """Rms of residuals (signals, n) over the floor, by signal."""
    return {k: float(np.sqrt(np.mean(residual[k, rows] ** 2)) / floor) for k, floor in floors.items()}
