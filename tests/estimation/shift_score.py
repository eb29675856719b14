"""How an estimate of E, and a tension, did over a shift: sums that cycles are added to, so that hours fit in memory."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Two-sided 95 % of a normal distribution, in standard deviations.
INTERVAL = 1.96
#: E counts as right within this share.
WITHIN = 0.01
#: A line moves from this speed on, m/s.
MOVES_M_S = 0.05
#: A step is a change from one cycle to the next by more than this share (a drift of 1 % a minute: 3e-7; a splice of
#: 10 % that comes into a span of 6 m at 2 m/s: 1e-4), or so many N of a set-point; what follows it within this time is
#: not scored, s.
STEP_SHARE, STEP_N, AFTER_STEP_S = 5e-5, 0.2, 1.0
#: Half widths are counted by their logarithm, from 10^-5 to 10 (of E) in this many classes: 1 % wide.
_CLASSES, _DECADES, _LEAST = 1200, 6.0, -5.0


@dataclass
class EstimateScore:
    """E beside the true one, over the cycles that count."""

    cycles: int = 0
    within: int = 0
    held: int = 0
    worst: float = 0.0  #: relative, signed
    widths: NDArray[np.int64] = field(default_factory=lambda: np.zeros(_CLASSES, np.int64))

    def add(self, estimate: Array, deviation: Array, true: Array, counts: Mask) -> None:
        """Count cycles, all arrays (n,); what is no number is as wrong as can be."""
        error = estimate[counts] / true[counts] - 1.0
        half = INTERVAL * deviation[counts] / true[counts]
        if not len(error):
            return
        error = np.where(np.isfinite(error), error, np.inf)
        half = np.where(np.isfinite(half), half, np.inf)
        self.cycles += len(error)
        self.within += int(np.count_nonzero(np.abs(error) <= WITHIN))
        self.held += int(np.count_nonzero(np.abs(error) <= half))
        most = float(error[np.argmax(np.abs(error))])
        if abs(most) > abs(self.worst):
            self.worst = most
        at = (np.log10(np.clip(half, 10.0**_LEAST, 10.0 ** (_LEAST + _DECADES))) - _LEAST) / _DECADES * _CLASSES
        self.widths += np.bincount(np.minimum(at.astype(int), _CLASSES - 1), minlength=_CLASSES)

    @property
    def worst_pct(self) -> float:
        """Largest error."""
        return 100.0 * self.worst

    @property
    def within_pct(self) -> float:
        """Share of the cycles in which E was within 1 %."""
        return _pct(self.within, self.cycles)

    @property
    def held_pct(self) -> float:
        """Share of the cycles in which the 95 % interval held the true E."""
        return _pct(self.held, self.cycles)

    @property
    def half_width_pct(self) -> float:
        """Median half width of that interval, of E."""
        at = int(np.searchsorted(np.cumsum(self.widths), 0.5 * self.cycles))
        return float(100.0 * 10.0 ** (_LEAST + (at + 0.5) * _DECADES / _CLASSES))


@dataclass
class TensionScore:
    """A tension beside its set-point, over the cycles that count."""

    cycles: int = 0
    within: int = 0  #: 1 N
    worst_N: float = 0.0  #: signed

    def add(self, tension_N: Array, set_point_N: Array, counts: Mask) -> None:
        """Count cycles, all arrays (n,)."""
        error = (tension_N - set_point_N)[counts]
        if not len(error):
            return
        self.cycles += len(error)
        self.within += int(np.count_nonzero(np.abs(error) <= 1.0))
        most = float(error[np.argmax(np.abs(error))])
        if abs(most) > abs(self.worst_N):
            self.worst_N = most

    @property
    def within_pct(self) -> float:
        """Share of the cycles in which it was within 1 N."""
        return _pct(self.within, self.cycles)


def _pct(count: int, of: int) -> float:
    return 100.0 * count / of if of else float("nan")


def shares_of_steps(values: Array) -> Mask:
    """Cycles in which a quantity has stepped by more than `STEP_SHARE` of itself, (n,)."""
    return np.concatenate([[False], np.abs(np.diff(values)) > STEP_SHARE * np.abs(values[:-1])])


def behind(steps: Mask, cycles: int) -> Mask:
    """So many cycles from each step on, (n,)."""
    total = np.concatenate([np.zeros(cycles, np.int64), np.cumsum(steps)])
    return np.asarray(total[cycles:] - total[:-cycles] > 0) if cycles else steps
