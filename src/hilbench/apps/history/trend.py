"""How a quantity of a stand changes over days: level, rate, sudden changes, and when a limit will be reached.

What is known of a quantity is a value from each of some runs, each with a stated standard deviation. Runs repeat worse
than they state, and days differ by what nobody measures (temperature), so that neighbouring days are alike. The model:

    value_i = level + rate·t_i + changes(t_i) + w(t_i) + r_i + e_i

e_i has the stated deviation, r_i that of the repeats beyond it (the between-study variance of random-effects
meta-analysis, DerSimonian and Laird, 1986), w is a stationary process with exponential correlation over days. Changes
are steps (a part was exchanged), kinks (the rate is another from a day on), and single runs that are off. Level and
rate have flat priors, so the likelihood is the restricted one (Patterson and Thompson, 1971). Which changes there are,
and how large repeats and days vary, is not chosen but averaged over by likelihood (Hoeting et al., Bayesian Model
Averaging, 1999): with few days the intervals are as wide as what cannot be told apart makes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, special

Array = NDArray[np.float64]
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
    """When a limit will be reached, days from the last run: median, and 90 % interval; infinite for never."""

    limit: float
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
    reached: tuple[Reached, ...]  #: one a limit ahead; none where no trend is reported
    band_d: Array  #: (m,) times of the band
    band: Array  #: (m,) mean
    band_low: Array  #: (m,) of 95 %
    band_high: Array


def trend(
    days: ArrayLike,
    values: ArrayLike,
    deviations: ArrayLike,
    *,
    limits: Sequence[float] = (),
    ahead_d: float = 0.0,
    least_rate_per_d: float = 0.0,
) -> Trend | None:
    """The trend of values (n,) at days (n,), with stated standard deviations (n,); None where all runs are of one day.

    limits: values of which it is asked when they are reached; ahead_d: how far beyond the last run the band goes.
    least_rate_per_d: slower ones are not reported. Raises ValueError for what is not finite.
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
    return _Average(points).trend(limits, ahead_d, least_rate_per_d, may_report=long_enough)


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

    def rates(self) -> Array:
        """Contribution of each to the rate at the last run, (K,)."""
        return np.where(self.kinds == "kink", 1.0, 0.0)


@dataclass(frozen=True)
class _Noise:
    """One variance model of runs and days, and products of the whitened columns under it."""

    repeat: float
    daily: float
    log_weight: float  #: probability before the data are seen, and what the determinant adds
    gram: Array  #: of value, 1, time, candidates


class _Average:
    """All models together, by their probability."""

    def __init__(self, points: _Points) -> None:
        self._points = points
        self._end = float(points.t[-1])
        self._candidates = _Candidates.of(points)
        columns = np.column_stack([points.y, np.ones(len(points.t)), points.t - self._end, self._candidates.columns])
        self._noises = [
            _noise(points, columns, repeat, daily, correlated_d)
            for repeat in _REPEAT
            for daily in _DAILY
            for correlated_d in (_CORRELATED_D if daily else _CORRELATED_D[:1])
        ]
        self._chosen = self._search()

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
        sure = [self._shares(one, chosen)[0].sum() for one in chosen]
        if sure and min(sure) < CHANGE_SURE:
            del chosen[int(np.argmin(sure))]
        return chosen

    def _shares(self, one: int, chosen: Sequence[int]) -> tuple[Array, NDArray[np.int64]]:
        """Probability of each candidate of the kind of a chosen one, given the others, and which these are."""
        weights = self._weights([each for each in chosen if each != one])[0]
        alike = np.flatnonzero(self._candidates.kinds == self._candidates.kinds[one])
        return weights[:, alike + 1].sum(axis=0), alike

    def _again(self, chosen: list[int]) -> list[int]:
        for at in range(len(chosen)):
            others = [*chosen[:at], *chosen[at + 1 :]]
            found = self._most_probable(others)
            if found is not None and found not in others:
                chosen = [*chosen[:at], found, *chosen[at + 1 :]]
        return chosen

    def _most_probable(self, chosen: list[int]) -> int | None:
        """Most probable candidate given those chosen; None where it is not certain that there is one."""
        weights = self._weights(chosen)[0].sum(axis=0)
        if weights[1:].sum() < CHANGE_SURE:
            return None
        best = int(np.argmax(weights[1:]))
        return best if best not in chosen else None

    def _weights(self, chosen: list[int]) -> tuple[Array, list[_Posterior]]:
        """Probability of each variance model (rows) and of no further change, or each candidate (columns)."""
        posteriors = [_Posterior(noise, self._candidates, chosen) for noise in self._noises]
        logs = np.array([each.log_weights for each in posteriors])
        return np.exp(logs - special.logsumexp(logs)), posteriors

    def trend(self, limits: Sequence[float], ahead_d: float, least_rate_per_d: float, *, may_report: bool) -> Trend:
        """Trend by Bayesian model averaging."""
        points, scatter = self._points, self._points.scatter
        weights, posteriors = self._weights(self._chosen)
        last = float(points.t[-1])
        band_d = np.unique(np.concatenate([points.t, np.linspace(points.t[0], last + ahead_d, 120)]))
        # Level and rate at the end, then the band.
        rows = np.vstack([self._row(last), self._rate_row(), *(self._row(float(at)) for at in band_d)])
        base, more = rows[:, :2], rows[:, 2:]
        mixture = _Mixture.of(weights, posteriors, base, more)
        level, rate = mixture.moments(0), mixture.moments(1)
        rising = mixture.above(1, least_rate_per_d / scatter)
        falling = 1.0 - mixture.above(1, -least_rate_per_d / scatter)
        direction: Direction | None = None
        if may_report and max(rising, falling) >= SURE:
            direction = "rising" if rising > falling else "falling"
        means, deviations = np.array([mixture.moments(k) for k in range(2, len(rows))]).T
        positive = mixture.above(1, 0.0)
        low, high = mixture.interval(0)
        middle = points.middle
        rate_low, rate_high = mixture.interval(1)
        return Trend(
            level=middle + scatter * level[0],
            level_ci95=(middle + scatter * low, middle + scatter * high),
            rate_per_d=scatter * rate[0],
            rate_ci95=(scatter * rate_low, scatter * rate_high),
            sure=max(positive, 1.0 - positive),
            direction=direction,
            repeat_sd=scatter * self._mean_of(weights, "repeat"),
            daily_sd=scatter * self._mean_of(weights, "daily"),
            changes=tuple(self._changes()),
            reached=tuple(found for limit in limits if (found := self._reached(mixture, limit, direction)) is not None),
            band_d=band_d,
            band=middle + scatter * means,
            band_low=middle + scatter * (means - _NORMAL_95 * deviations),
            band_high=middle + scatter * (means + _NORMAL_95 * deviations),
        )

    def _row(self, at: float) -> Array:
        """Regressor row of the mean at a time: level, rate and candidates."""
        return np.concatenate([[1.0, at - self._end], self._candidates.at(np.array([at]), self._points)[0]])

    def _rate_row(self) -> Array:
        return np.concatenate([[0.0, 1.0], self._candidates.rates()])

    def _mean_of(self, weights: Array, name: str) -> float:
        sizes = np.array([getattr(noise, name) for noise in self._noises])
        return float(np.sqrt(weights.sum(axis=1) @ sizes**2))

    def _changes(self) -> list[Change]:
        """The sure ones, in their order, each as the others leave it."""
        found = []
        for one in self._chosen:
            weights, posteriors = self._weights([each for each in self._chosen if each != one])
            kind, t = str(self._candidates.kinds[one]), self._points.t
            shares, alike = self._shares(one, self._chosen)
            probability = float(shares.sum())
            # Where it may have been as well: the places that have the most probable 90 % of it.
            order = np.argsort(-shares)
            count = int(np.searchsorted(np.cumsum(shares[order]), 0.9 * probability)) + 1
            places = self._candidates.places[alike[order[:count]]]
            first, last = int(places.min()), int(places.max())
            each = np.array([posterior.size_of(one) for posterior in posteriors])
            share = weights[:, one + 1] / max(float(weights[:, one + 1].sum()), 1e-300)
            mean = float(share @ each[:, 0])
            variance = float(share @ (each[:, 1] + (each[:, 0] - mean) ** 2))
            size, sd = self._points.scatter * mean, self._points.scatter * variance**0.5
            begins = float(t[first]) if kind == "outlier" else float(t[first - 1])
            found.append(Change(kind, begins, float(t[last]), size, sd, probability))  # type: ignore[arg-type]
        return sorted(found, key=lambda change: (change.before_d, change.kind))

    def _reached(self, mixture: _Mixture, limit: float, direction: Direction | None) -> Reached | None:
        """When a limit is reached at the rate of now; None where nothing is said to move towards it."""
        distance = (limit - self._points.middle) / self._points.scatter
        level = mixture.moments(0)[0]
        if direction is None or (distance > level) != (direction == "rising"):
            return None
        levels, rates = mixture.draws()
        with np.errstate(divide="ignore", invalid="ignore"):
            days = (distance - levels) / rates
        days = np.where(rates * (distance - level) > 0.0, np.maximum(days, 0.0), np.inf)
        early, middle, late = (float(each) for each in np.quantile(days, [0.05, 0.5, 0.95], method="nearest"))
        return Reached(limit, middle, early, late)


def _noise(points: _Points, columns: Array, repeat: float, daily: float, correlated_d: float) -> _Noise:
    apart = np.abs(points.t[:, None] - points.t[None, :])
    covariance = daily**2 * np.exp(-apart / correlated_d)
    covariance[np.diag_indices_from(covariance)] += points.variance + repeat**2 / points.runs + 1e-4
    lower = linalg.cholesky(covariance, lower=True)
    white = linalg.solve_triangular(lower, columns, lower=True)
    ways = len(_CORRELATED_D) if daily else 1
    log_weight = -float(np.sum(np.log(np.diag(lower)))) - daily / _DAILY_SCALE - np.log(ways)
    return _Noise(repeat, daily, log_weight, white.T @ white)


class _Posterior:
    """Posterior of level, rate and chosen changes under one variance model, alone and with each further candidate."""

    def __init__(self, noise: _Noise, candidates: _Candidates, chosen: Sequence[int]) -> None:
        own = np.array([1, 2, *(3 + k for k in chosen)])
        gram = noise.gram
        precision = np.concatenate([np.zeros(2), candidates.size[list(chosen)] ** -2.0])
        normal = gram[np.ix_(own, own)] + np.diag(precision)
        self.inverse = linalg.inv(normal)
        self.mean = self.inverse @ gram[own, 0]
        with_each = gram[own, 3:]  # (own, K)
        self.mixed = self.inverse @ with_each
        self.left = np.diag(gram)[3:] + candidates.size**-2.0 - np.sum(with_each * self.mixed, axis=0)
        towards = gram[3:, 0] - with_each.T @ self.mean
        self.gain = towards / self.left
        self.chosen = list(chosen)
        quality = gram[0, 0] - float(gram[own, 0] @ self.mean)
        alone = noise.log_weight - 0.5 * (float(np.linalg.slogdet(normal)[1]) + quality)
        alone += float(np.sum(np.log(candidates.size[list(chosen)] ** -1.0))) + float(
            np.sum(candidates.log_prior[list(chosen)])
        )
        further = candidates.log_prior - np.log(candidates.size) - 0.5 * np.log(self.left) + 0.5 * towards * self.gain
        further[list(chosen)] = -np.inf
        self.log_weights = np.concatenate([[alone], alone + further])

    def size_of(self, candidate: int) -> tuple[float, float]:
        """Mean and variance of a further candidate's size."""
        return float(self.gain[candidate]), float(1.0 / self.left[candidate])


@dataclass(frozen=True)
class _Mixture:
    """Normal distributions of some figures: mean and covariance of each model that counts, by its weight."""

    weights: Array  #: (models,)
    means: Array  #: (models, figures)
    variances: Array  #: (models, figures)
    crossed: Array  #: (models,): covariance of the first two figures

    @classmethod
    def of(cls, weights: Array, posteriors: Sequence[_Posterior], base: Array, more: Array) -> _Mixture:
        """base (figures, 2), more (figures, K): what makes the figures of level and rate, and of the candidates."""
        parts = []
        for row, posterior in zip(weights, posteriors, strict=True):
            own = np.hstack([base, more[:, posterior.chosen]])
            mean, spread = own @ posterior.mean, own @ posterior.inverse
            lever = more - own @ posterior.mixed  # (figures, K): what a candidate's size adds beside the others
            steps = np.column_stack([np.zeros(len(own)), lever * posterior.gain])
            squares = np.column_stack([np.zeros(len(own)), lever**2 / posterior.left])
            crosses = np.concatenate([[0.0], lever[0] * lever[1] / posterior.left])
            counts = row > _LEAST_WEIGHT
            of_own = mean[:, None] + steps, np.sum(spread * own, axis=1)[:, None] + squares
            parts.append([row, of_own[0].T, of_own[1].T, spread[0] @ own[1] + crosses])
            parts[-1] = [each[counts] for each in parts[-1]]
        total, means, variances, crossed = (np.concatenate(each) for each in zip(*parts, strict=True))
        return cls(total / total.sum(), means, variances, crossed)

    def moments(self, figure: int) -> tuple[float, float]:
        """Mean and standard deviation."""
        mean = float(self.weights @ self.means[:, figure])
        square = self.variances[:, figure] + (self.means[:, figure] - mean) ** 2
        return mean, float(np.sqrt(self.weights @ square))

    def above(self, figure: int, value: float) -> float:
        """Probability that a figure is above a value."""
        off = (self.means[:, figure] - value) / np.sqrt(self.variances[:, figure])
        return float(self.weights @ special.ndtr(off))

    def interval(self, figure: int) -> tuple[float, float]:
        """95 % interval, between its quantiles."""
        mean, deviation = self.moments(figure)
        at = mean + deviation * np.linspace(-8.0, 8.0, 321)
        off = (at[:, None] - self.means[None, :, figure]) / np.sqrt(self.variances[None, :, figure])
        below = special.ndtr(off) @ self.weights
        low, high = np.interp([0.025, 0.975], below, at)
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
