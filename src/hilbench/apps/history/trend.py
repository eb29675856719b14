"""Trend of a quantity of a stand over days: level, rate, sudden changes, and when a limit will be reached.

What is known of a quantity is a value from each of some runs, each with a stated standard deviation. Runs repeat worse
than they state, and days differ by what nobody measures (temperature), so that neighbouring days are alike. The model:

    value_i = level + rate·t_i + changes(t_i) + w(t_i) + r_i + e_i

e_i has the stated deviation, r_i that of the repeats beyond it (the between-study variance of random-effects
meta-analysis, DerSimonian and Laird, 1986), w is a stationary process with exponential correlation over days. Changes
are steps (a part was exchanged), kinks (the rate is another from a day on), and single runs that are off. Level and
rate have flat priors, so the likelihood is the restricted one (Patterson and Thompson, 1971). Which changes there are,
and how large repeats and days vary, is not chosen but averaged over by likelihood (Hoeting et al., Bayesian Model
Averaging, 1999): with few days the intervals are as wide as what cannot be separated makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from hilbench.arrays import Array

ChangeKind = Literal["step", "kink", "outlier"]
Direction = Literal["rising", "falling"]

#: A rate is reported as a trend when its sign is at least so sure. A person looks every day: over a month of looks
#: some two of a hundred stands without a trend get one reported (`tools/history_stands.py`).
SURE: Final = 0.98
#: Least days with a run, and least time from the first to the last, d, before a trend is reported.
LEAST_DAYS: Final = 4
LEAST_LENGTH_D: Final = 3.0
#: A change is reported when it is at least so probable.
CHANGE_SURE: Final = 0.9
#: Runs that are no farther apart are one point, d; points beyond which neighbouring ones are taken together as well.
_TOGETHER_D: Final = 0.25
_MOST_POINTS: Final = 45
#: Of three runs and more that are taken together one is left out that is so many scatters off their median.
_FAR_OFF: Final = 4.0
_MOST_CHANGES: Final = 12

#: Sizes of the variations that are averaged over, in the scatter from run to run.
_REPEAT: Final = (0.0, 0.4, 0.8, 1.2, 1.8)
_DAILY: Final = (0.0, 0.4, 0.8, 1.4, 2.5)
_CORRELATED_D: Final = (0.7, 3.0)
#: A daily variation of so many scatters is e times less probable than none.
_DAILY_SCALE: Final = 1.0
#: Probability of a change: of a step and a kink in a gap between runs of two days, of an outlier in a run.
_PRIOR: Final[dict[str, float]] = {"step": 0.02, "kink": 0.002, "outlier": 0.03}
#: Points on either side from which on a rate may be another one.
_OF_A_RATE: Final = 3
#: Size of an outlier before it is seen, in the scatter from run to run.
_OUTLIER: Final = 8.0
_LEAST_WEIGHT: Final = 1e-4
_NORMAL_95: Final = 1.959964
_DRAWS: Final = 4000


@dataclass(frozen=True)
class Change:
    """A sudden change: between which runs (days), how large (in the quantity's unit; a kink's per day), how sure."""

    kind: ChangeKind
    after_d: float  #: of the last run before it; of an outlier the run itself
    before_d: float  #: of the first run after it
    size: float
    sd: float
    probability: float


@dataclass(frozen=True)
class Reached:
    """Time at which a limit will be reached, days from the last run: median, 90 % interval; infinite for never."""

    median_d: float
    from_d: float
    to_d: float


@dataclass(frozen=True)
class Trend:
    """Trend of a quantity. Times in days, on the axis of the runs; rates per day."""

    level: float  #: at the last run, without what passes
    level_ci95: tuple[float, float]
    rate_per_d: float  #: at the last run
    rate_ci95: tuple[float, float]
    sure: float  #: probability of the more probable sign of the rate
    direction: Direction | None  #: None: no trend is reported
    repeat_sd: float  #: how runs repeat beyond what they state
    daily_sd: float  #: how days vary
    changes: tuple[Change, ...]
    reached: Reached | None  #: of a limit ahead; None where no trend towards it is reported
    band_d: Array  #: (m,) times of the band
    band: Array  #: (m,) mean
    band_low: Array  #: (m,) of 95 %
    band_high: Array


def trend(
    days: ArrayLike,
    values: ArrayLike,
    deviations: ArrayLike,
    *,
    limit: float | None = None,
    ahead_d: float = 0.0,
) -> Trend | None:
    """The trend of values (n,) at days (n,), with stated standard deviations (n,); None where all runs are of one day.

    limit: a value whose time of arrival is predicted; ahead_d: how far beyond the last run the band goes.
    Raises ValueError for what is not finite.
    """
    t, y, s = (np.asarray(given, np.float64) for given in (days, values, deviations))
    if not (np.all(np.isfinite(t)) and np.all(np.isfinite(y)) and np.all(np.isfinite(s)) and np.all(s >= 0.0)):
        raise ValueError("days, values and deviations that are finite, deviations not below zero")
    if len(t) < 2 or np.ptp(t) <= 0.0:
        return None
    order = np.argsort(t, kind="stable")
    t, y, s = t[order], y[order], s[order]
    long_enough = len(np.unique(np.floor(t))) >= LEAST_DAYS and t[-1] - t[0] >= LEAST_LENGTH_D
    points = _Points.of(t, y, s)
    if len(points.t) < 2:
        return None
    return _Average(points).trend(limit, ahead_d, may_report=long_enough)


@dataclass(frozen=True)
class _Points:
    """Runs, neighbouring ones taken together where there are many; values in units of the scatter."""

    t: Array
    y: Array
    variance: Array  #: as stated
    runs: Array  #: how many are in each
    middle: float
    scatter: float  #: from run to run

    @classmethod
    def of(cls, t: Array, y: Array, s: Array) -> _Points:
        middle, scatter = float(np.median(y)), _scatter(t, y, s)
        t, z, variance, runs = _together(t, (y - middle) / scatter, (s / scatter) ** 2)
        return cls(t, z, variance, runs, middle, scatter)


def _scatter(t: Array, y: Array, s: Array) -> float:
    """Standard deviation of what differs from one run to the next, robust; at least what is stated of it."""
    if len(y) > 2:  # of the middle one against the line through its neighbours: what grows evenly is no scatter
        share = (t[1:-1] - t[:-2]) / np.maximum(t[2:] - t[:-2], 1e-12)
        off = y[1:-1] - (1.0 - share) * y[:-2] - share * y[2:]
        off /= np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
        found = float(np.median(np.abs(off)) / 0.6745)
    else:
        found = float(np.abs(y[1] - y[0]))
    least = max(1e-9 * float(np.max(np.abs(y))), 1e-300)
    return max(found, float(np.median(s)), least)


def _together(t: Array, z: Array, variance: Array) -> tuple[Array, Array, Array, Array]:
    """Time, value, stated variance and number of runs of each point."""
    points = []
    for rows in (part for group in _groups(t) for part in _agreeing(group, z)):
        weight = 1.0 / (variance[rows] + 1.0)
        weight /= weight.sum()
        points.append((weight @ t[rows], weight @ z[rows], weight**2 @ variance[rows], 1.0 / np.sum(weight**2)))
    time, value, stated, runs = np.array(points).T
    return time, value, stated, runs


def _agreeing(rows: NDArray[np.int64], z: Array) -> list[NDArray[np.int64]]:
    """Runs of one time as one point, without those far from the others; two that differ stay apart: one is off."""
    near = np.abs(z[rows] - np.median(z[rows])) <= _FAR_OFF
    if len(rows) > 2:
        return [rows[near]] if near.any() else [rows]
    return [rows] if np.ptp(z[rows]) <= _FAR_OFF else list(rows[:, None])


def _groups(t: Array) -> list[NDArray[np.int64]]:
    """Runs that are taken together."""
    apart_d = _TOGETHER_D
    while True:
        begins, first = [0], t[0]
        for at in range(1, len(t)):
            if t[at] - first > apart_d:
                begins.append(at)
                first = t[at]
        if len(begins) <= _MOST_POINTS:
            return np.split(np.arange(len(t)), begins[1:])
        apart_d *= 1.3


@dataclass(frozen=True)
class _Candidates:
    """Every change that there may be: its column (n, K), kind, place, probability and the size to be expected."""

    columns: Array
    kinds: NDArray[np.str_]
    places: NDArray[np.int64]  #: the run after it
    log_prior: Array
    size: Array  #: standard deviation before it is seen

    @classmethod
    def of(cls, points: _Points) -> _Candidates:
        t, n = points.t, len(points.t)
        gaps = np.flatnonzero(np.diff(t) > 0.0) + 1
        spread = max(float(np.ptp(points.y)), _OUTLIER)
        inner = gaps[(gaps >= _OF_A_RATE) & (gaps <= n - _OF_A_RATE)]
        after = t[:, None] >= t[None, gaps]
        kinks = np.maximum(t[:, None] - t[None, inner - 1], 0.0)
        parts = (
            ("step", after.astype(np.float64), gaps, spread),
            ("kink", kinks, inner, 2.0 * spread / float(t[-1] - t[0])),
            ("outlier", np.eye(n), np.arange(n), _OUTLIER),
        )
        return cls(
            np.hstack([columns for _, columns, _, _ in parts]),
            np.concatenate([np.full(len(places), kind) for kind, _, places, _ in parts]),
            np.concatenate([places for _, _, places, _ in parts]),
            np.concatenate([np.full(len(places), np.log(_PRIOR[kind])) for kind, _, places, _ in parts]),
            np.concatenate([np.full(len(places), size) for _, _, places, size in parts]),
        )

    def at(self, t: Array, points: _Points) -> Array:
        """The columns at other times (m, K); what passes is in none of them."""
        found = np.zeros((len(t), len(self.kinds)))
        of_steps, of_kinks = self.kinds == "step", self.kinds == "kink"
        found[:, of_steps] = t[:, None] >= points.t[None, self.places[of_steps]]
        found[:, of_kinks] = np.maximum(t[:, None] - points.t[None, self.places[of_kinks] - 1], 0.0)
        return found


@dataclass(frozen=True)
class _Fit:
    """Posteriors of level, rate and chosen changes: under each of N variance models, alone and with each further one of
    K candidates."""

    chosen: list[int]
    weights: Array  #: (N, 1 + K): probability that there is no further change, and of each candidate
    mean: Array  #: (N, own): of level, rate and the sizes of those chosen
    inverse: Array  #: (N, own, own): their covariance
    mixed: Array  #: (N, own, K): by how much each candidate's size moves them
    gain: Array  #: (N, K): mean of a candidate's size
    left: Array  #: (N, K): inverse variance of it


class _Average:
    """Average of all models by their probability."""

    def __init__(self, points: _Points) -> None:
        self._points, self._end = points, float(points.t[-1])
        self._candidates = _Candidates.of(points)
        columns = np.column_stack([points.y, np.ones(len(points.t)), points.t - self._end, self._candidates.columns])
        grid = [
            (repeat, daily, correlated_d)
            for repeat in _REPEAT
            for daily in _DAILY
            for correlated_d in (_CORRELATED_D if daily else _CORRELATED_D[:1])
        ]
        self._repeat, self._daily, correlated_d = np.array(grid).T
        apart = np.abs(points.t[:, None] - points.t[None, :])
        covariance = self._daily[:, None, None] ** 2 * np.exp(-apart / correlated_d[:, None, None])
        of_runs = points.variance + self._repeat[:, None] ** 2 / points.runs + 1e-4
        covariance += of_runs[:, :, None] * np.eye(len(points.t))
        lower = np.linalg.cholesky(covariance)
        white = np.linalg.solve(lower, np.broadcast_to(columns, (len(grid), *columns.shape)))
        ways = np.where(self._daily > 0.0, len(_CORRELATED_D), 1)
        # Probability of a variance model before the data are seen, and what the determinant adds.
        self._log_weight = -np.sum(np.log(np.einsum("nii->ni", lower)), axis=1)
        self._log_weight -= self._daily / _DAILY_SCALE + np.log(ways)
        self._gram = white.transpose(0, 2, 1) @ white  # of value, 1, time, candidates
        self._chosen = self._search()

    def _fit(self, chosen: Sequence[int]) -> _Fit:
        gram, size, log_prior = self._gram, self._candidates.size, self._candidates.log_prior
        own, taken = [1, 2, *(3 + k for k in chosen)], list(chosen)
        normal = gram[:, own][:, :, own] + np.diag([0.0, 0.0, *size[taken] ** -2.0])
        inverse, seen = np.linalg.inv(normal), gram[:, own, 0]
        mean = np.einsum("nij,nj->ni", inverse, seen)
        with_each = gram[:, own, 3:]
        mixed = inverse @ with_each
        left = np.einsum("nii->ni", gram)[:, 3:] + size**-2.0 - np.sum(with_each * mixed, axis=1)
        towards = gram[:, 3:, 0] - np.einsum("nik,ni->nk", with_each, mean)
        quality = gram[:, 0, 0] - np.sum(seen * mean, axis=1)
        alone = self._log_weight - 0.5 * (np.linalg.slogdet(normal)[1] + quality)
        alone += np.sum(log_prior[taken] - np.log(size[taken]))
        further = log_prior - np.log(size) - 0.5 * np.log(left) + 0.5 * towards**2 / left
        further[:, taken] = -np.inf
        logs = np.column_stack([alone, alone[:, None] + further])
        weights = np.exp(logs - special.logsumexp(logs))
        return _Fit(taken, weights, mean, inverse, mixed, towards / left, left)

    def _search(self) -> list[int]:
        """Find the changes that are certain, one after the other, then each again given the others.

        One whose kind is not (the last run is off: will it stay so?) is left to the average.
        """
        chosen: list[int] = []
        while len(chosen) < _MOST_CHANGES:
            found = self._most_probable(chosen)
            if found is None:
                break
            chosen.append(found)
            if len(chosen) > 1:
                chosen = self._again(chosen)
        sure = [self._beside(one, chosen)[1].sum() for one in chosen]
        if sure and min(sure) < CHANGE_SURE:
            del chosen[int(np.argmin(sure))]
        return chosen

    def _beside(self, one: int, chosen: Sequence[int]) -> tuple[_Fit, Array]:
        """The fit of the other chosen ones, and given these the probability of each candidate, 0 for other kinds."""
        fit = self._fit([each for each in chosen if each != one])
        alike = self._candidates.kinds == self._candidates.kinds[one]
        return fit, np.where(alike, fit.weights[:, 1:].sum(axis=0), 0.0)

    def _again(self, chosen: list[int]) -> list[int]:
        for at in range(len(chosen)):
            others = [*chosen[:at], *chosen[at + 1 :]]
            found = self._most_probable(others)
            if found is not None and found not in others:
                chosen = [*chosen[:at], found, *chosen[at + 1 :]]
        return chosen

    def _most_probable(self, chosen: list[int]) -> int | None:
        """Most probable candidate given those chosen; None where it is not certain that there is one."""
        weights = self._fit(chosen).weights[:, 1:].sum(axis=0)
        best = int(np.argmax(weights))
        return best if weights.sum() >= CHANGE_SURE and best not in chosen else None

    def trend(self, limit: float | None, ahead_d: float, *, may_report: bool) -> Trend:
        """Trend by Bayesian model averaging."""
        points, scatter, middle, fit = self._points, self._points.scatter, self._points.middle, self._fit(self._chosen)
        band_d = np.unique(np.concatenate([points.t, np.linspace(points.t[0], self._end + ahead_d, 120)]))
        times = np.array([self._end, *band_d])
        levels = np.column_stack([np.ones(len(times)), times - self._end, self._candidates.at(times, points)])
        rate = np.array([0.0, 1.0, *(self._candidates.kinds == "kink")], np.float64)
        mixture = _Mixture.of(fit, np.vstack([levels[0], rate, levels[1:]]))  # level and rate at the end, the band
        means, deviations = mixture.moments()
        rising = mixture.above(1, 0.0)
        sure = max(rising, 1.0 - rising)
        direction: Direction | None = None
        if may_report and sure >= SURE:
            direction = "rising" if rising > 0.5 else "falling"
        low, high = mixture.interval(0)
        rate_low, rate_high = mixture.interval(1)
        band, half = middle + scatter * means[2:], scatter * _NORMAL_95 * deviations[2:]
        variances = fit.weights.sum(axis=1)
        return Trend(
            level=middle + scatter * float(means[0]),
            level_ci95=(middle + scatter * low, middle + scatter * high),
            rate_per_d=scatter * float(means[1]),
            rate_ci95=(scatter * rate_low, scatter * rate_high),
            sure=sure,
            direction=direction,
            repeat_sd=scatter * float(np.sqrt(variances @ self._repeat**2)),
            daily_sd=scatter * float(np.sqrt(variances @ self._daily**2)),
            changes=tuple(self._changes()),
            reached=None if limit is None else self._reached(mixture, limit, direction),
            band_d=band_d,
            band=band,
            band_low=band - half,
            band_high=band + half,
        )

    def _changes(self) -> list[Change]:
        """The sure ones, in their order, each as the others leave it."""
        found = []
        for one in self._chosen:
            kind, t = str(self._candidates.kinds[one]), self._points.t
            fit, shares = self._beside(one, self._chosen)
            probability = float(shares.sum())
            # Where it may have been as well: the places that have the most probable 90 % of it.
            order = np.argsort(-shares, kind="stable")
            count = int(np.searchsorted(np.cumsum(shares[order]), 0.9 * probability)) + 1
            places = self._candidates.places[order[:count]]
            first, last = int(places.min()), int(places.max())
            share = fit.weights[:, one + 1] / max(float(fit.weights[:, one + 1].sum()), 1e-300)
            mean = float(share @ fit.gain[:, one])
            variance = float(share @ (1.0 / fit.left[:, one] + (fit.gain[:, one] - mean) ** 2))
            size, sd = self._points.scatter * mean, self._points.scatter * variance**0.5
            begins = float(t[first]) if kind == "outlier" else float(t[first - 1])
            found.append(Change(kind, begins, float(t[last]), size, sd, probability))  # type: ignore[arg-type]
        return sorted(found, key=lambda change: (change.before_d, change.kind))

    def _reached(self, mixture: _Mixture, limit: float, direction: Direction | None) -> Reached | None:
        """Time at which a limit is reached at the present rate; None where the quantity does not move towards it."""
        distance = (limit - self._points.middle) / self._points.scatter
        level = float(mixture.moments()[0][0])
        if direction is None or (distance > level) != (direction == "rising"):
            return None
        levels, rates = mixture.draws()
        with np.errstate(divide="ignore", invalid="ignore"):
            days = (distance - levels) / rates
        days = np.where(rates * (distance - level) > 0.0, np.maximum(days, 0.0), np.inf)
        early, middle, late = (float(each) for each in np.quantile(days, [0.05, 0.5, 0.95], method="nearest"))
        return Reached(middle, early, late)


@dataclass(frozen=True)
class _Mixture:
    """Normal distributions of some figures: mean and covariance of each model that counts, by its weight."""

    weights: Array  #: (models,)
    means: Array  #: (models, figures)
    variances: Array  #: (models, figures)
    crossed: Array  #: (models,): covariance of the first two figures

    @classmethod
    def of(cls, fit: _Fit, rows: Array) -> _Mixture:
        """rows (figures, 2 + K): what makes each figure of level and rate, and of the candidates."""
        own, more = np.hstack([rows[:, :2], rows[:, 2:][:, fit.chosen]]), rows[:, 2:]
        spread = own @ fit.inverse  # (N, figures, own)
        lever = more - own @ fit.mixed  # (N, figures, K): what a candidate's size adds beside the others
        nothing = np.zeros((*lever.shape[:2], 1))
        steps = np.concatenate([nothing, lever * fit.gain[:, None, :]], axis=2)
        squares = np.concatenate([nothing, lever**2 / fit.left[:, None, :]], axis=2)
        crosses = np.concatenate([nothing[:, 0], lever[:, 0] * lever[:, 1] / fit.left], axis=1)
        means = (fit.mean @ own.T)[:, :, None] + steps
        variances = np.sum(spread * own, axis=2)[:, :, None] + squares
        crossed = (spread[:, 0] @ own[1])[:, None] + crosses
        counts = fit.weights > _LEAST_WEIGHT
        total = fit.weights[counts]
        of_each = means.transpose(0, 2, 1)[counts], variances.transpose(0, 2, 1)[counts]
        return cls(total / total.sum(), *of_each, crossed[counts])

    def moments(self) -> tuple[Array, Array]:
        """Means and standard deviations of all figures."""
        mean = self.weights @ self.means
        return mean, np.sqrt(self.weights @ (self.variances + (self.means - mean) ** 2))

    def above(self, figure: int, value: float) -> float:
        """Probability that a figure is above a value."""
        off = (self.means[:, figure] - value) / np.sqrt(self.variances[:, figure])
        return float(self.weights @ special.ndtr(off))

    def interval(self, figure: int) -> tuple[float, float]:
        """95 % interval, between its quantiles."""
        mean, deviation = (float(each[figure]) for each in self.moments())
        at = mean + deviation * np.linspace(-8.0, 8.0, 321)
        off = (at[:, None] - self.means[None, :, figure]) / np.sqrt(self.variances[None, :, figure])
        low, high = np.interp([0.025, 0.975], special.ndtr(off) @ self.weights, at)
        return float(low), float(high)

    def draws(self) -> tuple[Array, Array]:
        """Draws of the first two figures, the same each time."""
        rng = np.random.default_rng(0)
        model = rng.choice(len(self.weights), _DRAWS, p=self.weights)
        first, second = rng.standard_normal((2, _DRAWS))
        sd = np.sqrt(self.variances[model, 0])
        levels = self.means[model, 0] + sd * first
        slope = self.crossed[model] / np.maximum(sd, 1e-300)
        rest = np.sqrt(np.maximum(self.variances[model, 1] - slope**2, 0.0))
        return levels, self.means[model, 1] + slope * first + rest * second
