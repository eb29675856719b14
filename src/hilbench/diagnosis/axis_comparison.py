"""What changed between two recordings of a lone axis, by one regression on the motion of both.

Every effect of the vocabulary may be there in both, the same; what differs is looked for step by step. On a real axis
what is left is never white noise, so a change has to hold over blocks of time, and to be larger than what the
vocabulary leaves unexplained of either recording; its interval comes from the blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.stats import t as student

from hilbench.diagnosis import machines
from hilbench.diagnosis.diagnosis import Diagnosis, Gap, GapLocation, NamedEffect, Unobservable, Value
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.noise import repeats, rms
from hilbench.diagnosis.predictor import Predictor, predictor_for
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_analysis import located
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import basis
from hilbench.diagnosis.terms import Term, extended, pack_with
from hilbench.plant.effect import Domain
from hilbench.plant.effects import EFFECTS
from hilbench.plant.model_file import Machine

Array = NDArray[np.float64]
Rows = NDArray[np.bool_]
Announce = Callable[[str, float], None]

#: Blocks of time of each recording, over which a change has to hold.
_BLOCKS: Final = 12
#: Standard errors, and times the rest that nothing explains, from which a change counts. Friction of a real drive
#: is another by some per cent at every start: what is less than the rest is no news.
_ERRORS: Final = 3.5
_OVER_THE_REST: Final = 2.0
#: Share of the torque of friction and offset that a change has to make at least.
_DRIFT: Final = 0.05
#: Difference of the criterion up to which two changes are tied, as for BIC.
_TIED: Final = 6.0
#: Most changes that are named.
_MOST: Final = 6
#: How many times as large the rest may be as it was before, until something has changed that nothing explains.
_MORE_REST: Final = 2.0
#: Ridge of the regression: keeps columns that say the same calm.
_RIDGE: Final = 1e-9
#: Share of an effect that may be left where another may have taken it out of the recorded torque.
_VANISHED: Final = 0.5
#: How often a strength is put right by what it makes.
_STRAIGHTENED: Final = 4
#: Highest order of the motor's turn that may differ.
_HIGHEST_ORDER: Final = 64.0
_TURN: Final = 2.0 * np.pi
#: Share of what the simple effects make that the band of a comparison holds, and how many times as wide it is; its
#: least width, Hz, and how far the filter reaches, in periods of its corner.
_BAND, _WIDER, _LOWEST_CORNER_HZ, _REACH = 0.95, 3.0, 5.0, 0.4
#: Corner in which an inertia is first estimated, Hz; speed, as a share of the highest, below which an axis stands.
_CORNER_HZ, _STANDSTILL = 10.0, 0.02
_ROWS_OF_WHERE: Final = 8
_RANK: Final = {effect.id: place for place, effect in enumerate(EFFECTS)}


def inertia(data: Measured) -> float:
    """Torque per acceleration of axis 1, fitted with friction and offset, N·m/(unit of x1_m/s²); above 0."""
    nyquist = 0.5 / data.period_s
    sos = butter(2, min(_CORNER_HZ, 0.5 * nyquist) / nyquist, output="sos")
    x = sosfiltfilt(sos, data.x_m[1])
    v = np.gradient(x, data.period_s)
    columns = np.array([np.gradient(v, data.period_s), v, np.sign(v), np.ones(len(v))])
    columns = sosfiltfilt(sos, columns, axis=1)
    torque = sosfiltfilt(sos, sosfiltfilt(sos, data.tau_Nm[1]))
    columns[0] = sosfiltfilt(sos, np.gradient(v, data.period_s))
    rows = (np.abs(v) > _STANDSTILL * float(np.max(np.abs(v)))) & data.usable(0.1)
    found, *_ = np.linalg.lstsq(columns[:, rows].T, torque[rows], rcond=None)
    least = 1e-3 * float(np.std(torque[rows])) / max(float(np.std(columns[0][rows])), 1e-300)
    return max(float(found[0]), least)


@dataclass
class _Side:
    """One recording: its residual with the model of before, and what each term would add, on the rows that count."""

    space: Space
    data: Measured
    residual: Array  #: (n,)
    columns: list[Array]  #: of each term (1 or 2, n)
    friction: Array  #: (n,) the torque of the simple effects but inertia, as they were before
    rows: Rows  #: those that count

    @property
    def predictor(self) -> Predictor:
        """Predictor of the recording."""
        return self.space.predictor

    def slow(self, corner_Hz: float) -> _Side:
        """This side low-pass filtered at a corner, without the rows that excluded ones reach through the filter."""
        period_s = self.data.period_s * self.predictor.every
        sos = butter(2, min(2.0 * corner_Hz * period_s, 0.95), output="sos")
        columns = [np.asarray(sosfiltfilt(sos, column, axis=1)) for column in self.columns]
        reach = np.ones(2 * round(_REACH / corner_Hz / period_s) + 1)
        rows = np.convolve(~self.rows, reach, "same") < 0.5
        residual, friction = (np.asarray(sosfiltfilt(sos, values)) for values in (self.residual, self.friction))
        return replace(self, residual=residual, friction=friction, columns=columns, rows=rows)


@dataclass(frozen=True)
class _Solved:
    """A joint fit: the shared strengths, the changes, and their covariance."""

    shared: Array
    change: Array
    covariance: Array
    residual: Array  #: of both recordings, the later one first, on the rows of the fit
    square: float  #: sum of the squares of it


class _Problem:
    """The later recording's rows, then those of the one before; each in units of its own rest."""

    def __init__(self, now: _Side, then: _Side, rows_now: Rows) -> None:
        rows = rows_now, then.rows
        self._sides = now, then
        self._shared = np.concatenate(
            [np.concatenate(side.columns)[:, chosen] for side, chosen in zip(self._sides, rows, strict=True)], axis=1
        )
        self._n = int(np.count_nonzero(rows_now))
        self._y = np.concatenate([now.residual[rows_now], then.residual[then.rows]])
        self._place = np.cumsum([0, *(len(column) for column in now.columns)])
        self._blocks = np.concatenate(
            [
                np.minimum(np.arange(count) * _BLOCKS // max(count, 1), _BLOCKS - 1) + first
                for count, first in ((self._n, 0), (len(self._y) - self._n, _BLOCKS))
            ]
        )
        self._friction = np.concatenate([now.friction[rows_now], then.friction[then.rows]])
        self._basis = basis(self._shared)
        self._fixed: tuple[list[int], Array] = [], self._basis

    def columns_of(self, chosen: list[int]) -> list[int]:
        """Columns of some terms."""
        return [column for k in chosen for column in range(self._place[k], self._place[k + 1])]

    def _differing(self, chosen: list[int]) -> Array:
        columns = self._shared[self.columns_of(chosen)].copy()
        columns[:, self._n :] = 0.0
        return columns

    def solved(self, chosen: list[int]) -> _Solved:
        """The joint fit with these terms free to differ."""
        differing = self._differing(chosen)
        both = np.concatenate([self._shared, differing])
        scale = np.maximum(np.linalg.norm(both, axis=1), 1e-300)
        normal = (both / scale[:, None]) @ (both / scale[:, None]).T + _RIDGE * np.eye(len(both))
        theta = np.linalg.solve(normal, (both / scale[:, None]) @ self._y) / scale
        rest = self._y - theta @ both
        shared, change = theta[: len(self._shared)], theta[len(self._shared) :]
        return _Solved(shared, change, self._covariance(differing, rest), rest, float(rest @ rest))

    def _covariance(self, differing: Array, rest: Array) -> Array:
        """Covariance of the changes: from blocks of time, never less than that of noise as coloured as the rest."""
        if len(differing) == 0:
            return np.empty((0, 0))
        free = differing - (differing @ self._basis.T) @ self._basis
        inverse = np.linalg.pinv(free @ free.T, rcond=1e-10, hermitian=True)
        scores = np.zeros((2 * _BLOCKS, len(free)))
        np.add.at(scores, self._blocks, (free * rest).T)
        blocks = inverse @ (scores.T @ scores) @ inverse
        coloured = inverse * float(np.mean(rest**2)) * max(repeats(rest[: self._n]), repeats(rest[self._n :]))
        larger = np.sqrt(np.maximum(np.diag(blocks), np.diag(coloured)))
        own = np.sqrt(np.maximum(np.diag(coloured), 1e-300))
        return np.asarray(coloured * np.outer(larger / own, larger / own))

    def gain(self, without: _Solved, chosen: list[int], one: int) -> float:
        """By how much the sum of squares falls when one more term may differ."""
        if chosen != self._fixed[0]:  # many are asked for beside the same ones, and a basis takes its time
            self._fixed = list(chosen), basis(np.concatenate([self._shared, self._differing(chosen)]))
        fixed = self._fixed[1]
        free = self._differing([one])
        free = free - (free @ fixed.T) @ fixed
        if float(np.sum(free**2)) <= 1e-8 * float(np.sum(self._differing([one]) ** 2)):
            return 0.0
        found, *_ = np.linalg.lstsq(free.T, without.residual, rcond=1e-8)
        return float(2.0 * found @ (free @ without.residual) - np.sum((found @ free) ** 2))

    def simple(self, count: int) -> Array:
        """Coordinates of the first `count` columns fitted to the earlier recording alone: with all others, which
        may be collinear, they would be meaningless."""
        columns, values = self._shared[:count, self._n :], self._y[self._n :]
        scale = np.maximum(np.linalg.norm(columns, axis=1), 1e-300)
        found, *_ = np.linalg.lstsq((columns / scale[:, None]).T, values, rcond=1e-10)
        return np.asarray(found / scale)

    def colour(self, rest: Array) -> float:
        """Variance of the rest times how many of its samples count as one."""
        return float(np.mean(rest**2)) * max(repeats(rest[: self._n]), repeats(rest[self._n :]))

    def part(self, chosen: list[int], one: int) -> slice:
        """Among the coordinates of the changes, those of one of the chosen."""
        at = np.cumsum([0, *(len(self.columns_of([k])) for k in chosen)])
        place = chosen.index(one)
        return slice(int(at[place]), int(at[place + 1]))

    def rms_Nm(self) -> float:
        """RMS of the torque of friction and offset in the earlier recording (the simple effects without the
        inertia)."""
        return float(np.sqrt(np.mean(self._friction[self._n :] ** 2)))

    def size(self, solved: _Solved, chosen: list[int], one: int) -> float:
        """Rms of what the change of one of the chosen terms makes of the later recording, N·m."""
        made = solved.change[self.part(chosen, one)] @ self._shared[self.columns_of([one])][:, : self._n]
        return float(np.sqrt(np.mean(made**2)))

    def rests(self, solved: _Solved) -> tuple[float, float]:
        """Rms of what is left in the later recording and in the one before, N·m."""
        now, then = solved.residual[: self._n], solved.residual[self._n :]
        return float(np.sqrt(np.mean(now**2))), float(np.sqrt(np.mean(then**2)))


def changes(model: Machine, now: Measured, then: Measured, announce: Announce) -> Diagnosis:
    """Find what differs in `now` from `then`, of one lone axis with `model`."""
    announce("simulate the model", 0.1)
    sides, base, terms = _prepared(model, now, then)
    announce(f"{len(terms)} effects that may differ", 0.4)
    problem = _Problem(*sides, sides[0].rows)
    judge = _Judge.of(problem, terms, len(base))
    chosen = judge.chosen()
    announce("judge what is left", 0.8)
    return _concluded(model, sides, base, judge, chosen)


def _prepared(model: Machine, now: Measured, then: Measured) -> tuple[tuple[_Side, _Side], list[Term], list[Term]]:
    """Both sides at a model with what is simple of the one before; those simple terms; all that may differ."""
    spaces = [Space(model, predictor_for(model, data), data.period_s) for data in (now, then)]
    proposer = Proposer(model, then)
    plain = [term for term in proposer.plain() if term.probe is None]  # others answer another strength in another way
    simple = [term for term in plain if not term.effect.removable or term.effect.domain is Domain.INERTIA]
    neutral = [space.residual([]) for space in spaces]
    start = [np.concatenate(s.strengths([], r, simple))[:, 0, :] for s, r in zip(spaces, neutral, strict=True)]
    rows = spaces[1].predictor.rows
    found, *_ = np.linalg.lstsq(start[1][:, rows].T, neutral[1][0, rows], rcond=1e-10)
    base = [term.at(term.neutral().coordinates() + value) for term, value in zip(simple, found, strict=True)]
    residuals = [space.residual(base) for space in spaces]
    heavy = [term for term in base if term.effect.domain is Domain.INERTIA]
    friction = [space.residual(heavy) - residual for space, residual in zip(spaces, residuals, strict=True)]
    others = [term for term in plain if term not in simple]
    others += _ripples(proposer, model, spaces, residuals, (now, then), base)
    sides = []
    for space, residual, made, data in zip(spaces, residuals, friction, (now, then), strict=True):
        own = list(space.point(base, residual).derivatives)
        more = [response[:, 0, :] for response in space.strengths(base, residual, others)]
        sides.append(_Side(space, data, residual[0], [*own, *more], made[0], _moving(space.predictor, data)))
    shown = [k for k in range(len(sides[0].columns)) if k < len(base) or any(np.any(s.columns[k]) for s in sides)]
    for side in sides:
        side.columns = [side.columns[k] for k in shown]
    others = [others[k - len(base)] for k in shown if k >= len(base)]
    # The acceleration is left out: its spectrum is mostly that of the encoder's counts.
    slow = [k for k, term in enumerate(base) if term.effect.domain is not Domain.INERTIA]
    corner_Hz = max(_corner_Hz(side, slow) for side in sides)
    return (sides[0].slow(corner_Hz), sides[1].slow(corner_Hz)), base, [*base, *others]


def _corner_Hz(side: _Side, simple: list[int]) -> float:
    """Corner frequency of the torque of the simple effects: above it there is only noise of the differentiated
    motion."""
    rows = side.rows
    made = np.concatenate([side.columns[k] for k in simple])
    scale = np.maximum(np.sqrt(np.mean(made[:, rows] ** 2, axis=1)), 1e-300)
    power = np.sum(np.abs(np.fft.rfft(np.where(rows, made / scale[:, None], 0.0), axis=1)) ** 2, axis=0)
    frequency = np.fft.rfftfreq(made.shape[1], side.data.period_s * side.predictor.every)
    upto = int(np.searchsorted(np.cumsum(power[1:]), _BAND * float(np.sum(power[1:])))) + 1
    return max(_WIDER * float(frequency[min(upto, len(frequency) - 1)]), _LOWEST_CORNER_HZ)


def _moving(predictor: Predictor, data: Measured) -> Rows:
    """Rows that count and in which the axis clearly moves: near standstill friction is not one law but many."""
    nyquist = 0.5 / data.period_s
    sos = butter(2, min(_CORNER_HZ, 0.5 * nyquist) / nyquist, output="sos")
    speed = np.abs(np.gradient(sosfiltfilt(sos, data.x_m[1])))[:: predictor.every]
    return np.asarray(predictor.rows & (speed > _STANDSTILL * float(np.max(speed))))


def _ripples(
    proposer: Proposer,
    model: Machine,
    spaces: list[Space],
    residuals: list[Array],
    data: tuple[Measured, Measured],
    base: list[Term],
) -> list[Term]:
    """Orders of the motor's turn that show in either recording."""
    named = {}
    found: list[Term] = []
    for space, residual, one in zip(spaces, residuals, data, strict=True):
        predictor = space.predictor
        values = np.where(predictor.rows, residual[0], 0.0)
        named = {predictor.names[0]: values}
        for term in Proposer(model, one).searched(named, base, predictor.every):
            order = term.values.get("order")
            if order is None or order > _HIGHEST_ORDER:
                continue
            if all(abs(order - other.values["order"]) > _apart(one, model) for other in found):
                found.append(term)
    return found


def _apart(data: Measured, model: Machine) -> float:
    """Order resolution: orders nearer to each other than this are indistinguishable."""
    return 2.0 * _TURN / max(float(np.ptp(data.x_m[1])) * model.motor_rad_per_unit(1), 1e-9)


@dataclass(frozen=True)
class _Judge:
    """Says which changes count."""

    problem: _Problem
    terms: list[Term]
    simple: int  #: the first so many terms are the simple ones
    least_Nm: float  #: rms of what a change has to make of the later recording

    @classmethod
    def of(cls, problem: _Problem, terms: list[Term], simple: int) -> _Judge:
        """By what nothing explains, and by what friction is another from start to start."""
        rest = max(problem.rests(problem.solved(list(range(len(terms))))))
        return cls(problem, terms, simple, max(_OVER_THE_REST * rest, _DRIFT * problem.rms_Nm()))

    def chosen(self) -> list[int]:
        """Which terms differ: the simple ones first, each time the one that explains most, as long as it counts."""
        everything = list(range(len(self.terms)))
        found = self._grown([], everything[: self.simple])
        found = self._grown(found, everything)
        # One effect that is as good as several of them is what happened.
        if len(found) > 1:
            best = self.problem.solved(found)
            allowed = _TIED * self.problem.colour(best.residual)
            for k in everything:
                alone = self.problem.solved([k])
                if alone.square - best.square < allowed and self.counts([k], k):
                    return [k]
        return found

    def _grown(self, chosen: list[int], offered: list[int]) -> list[int]:
        while len(chosen) < _MOST:
            here = self.problem.solved(chosen)
            gains = {k: self.problem.gain(here, chosen, k) for k in offered if k not in chosen}
            best = max(gains.values(), default=0.0)
            allowed = _TIED * self.problem.colour(here.residual)
            alike = [k for k, gain in gains.items() if gain > 0.0 and best - gain < allowed]
            ranked = sorted(alike, key=lambda k: (_RANK[self.terms[k].effect.id], -gains[k]))
            found = next((k for k in ranked if self.counts([*chosen, k], k)), None)
            if found is None:
                break
            grown = [*chosen, found]
            kept = [k for k in grown if self.counts(grown, k)]
            if kept == chosen:
                break
            chosen = kept
        return chosen

    def counts(self, chosen: list[int], one: int) -> bool:
        """True if the change of one of the chosen terms is significant (Wald test) and large enough to report."""
        problem = self.problem
        solved = problem.solved(chosen)
        part = problem.part(chosen, one)
        wald = float(solved.change[part] @ np.linalg.pinv(solved.covariance[part, part]) @ solved.change[part])
        return wald > _ERRORS**2 and problem.size(solved, chosen, one) > self.least_Nm


@dataclass(frozen=True)
class _Found:
    """The terms that differ, and what is known of each."""

    problem: _Problem
    terms: list[Term]
    chosen: list[int]
    solved: _Solved
    simple: Array  #: what the simple terms have to be moved by to explain the earlier recording alone
    bent: dict[int, float]  #: strength over what its response at a small one would say

    def columns(self, one: int) -> slice:
        """Among the coordinates of the changes, those of one of the chosen."""
        return self.problem.part(self.chosen, one)

    def before(self, one: int) -> Array:
        """The coordinates of a term before, in which the model is linear; neutral of what is not simple."""
        term = self.terms[one]
        here = term.coordinates()[: term.linear]
        return here + self.simple[one] if one < len(self.simple) else here

    def change(self, one: int) -> Array:
        """By how much they differ."""
        return np.asarray(self.solved.change[self.columns(one)] * self.bent.get(one, 1.0))


def _concluded(
    model: Machine, sides: tuple[_Side, _Side], base: list[Term], judge: _Judge, chosen: list[int]
) -> Diagnosis:
    now, then = sides
    problem, terms = judge.problem, judge.terms
    solved = problem.solved(chosen)
    bent = {}
    for k in (k for k in chosen if k >= len(base) and terms[k].linear == 1):
        bent[k] = _bent(now, base, terms[k], float(solved.change[problem.part(chosen, k)][0]))
    found = _Found(problem, terms, chosen, solved, problem.simple(len(base)), bent)
    # What a term is made of: those that are not there yet are looked at from their neutral strength.
    terms = [*base, *(term.neutral() for term in terms[len(base) :])]
    found = replace(found, terms=terms)
    rest_now, rest_then = problem.rests(found.solved)
    effects = [_named(model, found, k, problem, chosen) for k in chosen]
    predictor = now.predictor
    before, after = _residuals(now, then, chosen, now.rows)
    noise = predictor.floor(0)
    train, test = now.space.split.train & now.rows, now.space.split.test & now.rows
    held_before, held_after = _residuals(now, then, chosen, train)
    gap = Gap(predictor.names[0], rms(held_before[test]), rms(held_after[test]), noise, "N·m")
    conditions = predictor.conditions(pack_with(model, base))
    where = located(predictor.names, before[None] / noise, now.rows, conditions, _ROWS_OF_WHERE) if chosen else []
    unknown = rest_now > _MORE_REST * max(rest_then, noise)
    verdict = "unknown" if unknown else ("named" if chosen else "complete")
    left = located(predictor.names, after[None] / noise, now.rows, conditions, _ROWS_OF_WHERE) if unknown else []
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        gaps=[gap],
        where=[GapLocation(m.signal, m.when, f"{m.condition}: {m.detail}", round(share, 4)) for m, share in where],
        profiles=[],
        unexplained=[m for m, _ in left],
        unobservable=_hidden(found, judge.least_Nm),
        missing_channels=now.data.missing,
        model=extended(model, _as_now(found, len(base))),
        names=predictor.names,
        t_s=now.data.t_s[:: predictor.every][: len(before)],
        before=before[None],
        after=after[None],
        held_out=test,
        simulations=now.space.simulations + then.space.simulations,
        predicted_on="the measured motion of both recordings",
    )


def _bent(side: _Side, base: list[Term], term: Term, small: float) -> float:
    """Ratio of the strength needed to that extrapolated from the response at a small strength, for this much of it."""
    neutral = term.neutral()
    start, shape = neutral.coordinates()[: term.linear], neutral.coordinates()[term.linear :]
    rows, plain = side.rows, side.space.residual(base)[0]
    column = plain - side.space.residual([*base, neutral.at(np.concatenate([start + term.steps()[:1], shape]))])[0]
    column = column[rows] / term.steps()[0]
    strength = small
    for _ in range(_STRAIGHTENED):
        made = plain - side.space.residual([*base, neutral.at(np.concatenate([start + strength, shape]))])[0]
        reached = float(made[rows] @ column) / max(float(column @ column), 1e-300)
        if reached * small <= 0.0:
            return 1.0
        strength *= small / reached
    return strength / small


def _residuals(now: _Side, then: _Side, chosen: list[int], rows: Rows) -> tuple[Array, Array]:
    """The later recording's residual (n,) with the machine as it was, and as it is now, fitted to these rows of it."""
    problem = _Problem(now, then, rows)
    solved = problem.solved(chosen)
    columns = np.concatenate(now.columns)
    as_it_was = now.residual - solved.shared @ columns
    return as_it_was, as_it_was - solved.change @ columns[problem.columns_of(chosen)]


def _named(model: Machine, found: _Found, one: int, problem: _Problem, chosen: list[int]) -> NamedEffect:
    """A change with its 95 % interval, and what else it may be."""
    term, change = found.terms[one], found.change(one)
    covariance = found.solved.covariance[found.columns(one), found.columns(one)]
    wide = float(student.ppf(0.975, 2 * _BLOCKS - 1))
    then = found.before(one)
    strength = term.effect.parameter(term.effect.strength[0])
    values: dict[str, Value] = {}
    if term.has_phase:  # the wave that came on top of the one that was there
        moved = term.neutral().at(np.concatenate([change, term.coordinates()[term.linear :]]))
        gradient = moved.gradient()[:2, :2]
        errors = np.sqrt(np.maximum(np.diag(gradient @ covariance @ gradient.T), 0.0)) * wide
        for name, error in zip(moved.free()[:2], errors, strict=True):
            here = moved.values[name]
            values[name] = Value(here, (here - float(error), here + float(error)), term.effect.parameter(name).unit)
        values = {strength.name: replace(values[strength.name], before=float(np.hypot(*then)))} | {
            name: value for name, value in values.items() if name != strength.name
        }
    else:
        error = wide * float(np.sqrt(covariance[0, 0])) * found.bent.get(one, 1.0)
        here = float(change[0])
        values[strength.name] = Value(here, (here - error, here + error), strength.unit, before=float(then[0]))
    for parameter in term.effect.parameters:
        if parameter.name not in values and parameter.name not in term.effect.strength:
            here = term.values[parameter.name]
            values[parameter.name] = Value(here, (here, here), parameter.unit, before=here)
    rest = [k for k in chosen if k != one]
    without = problem.solved(rest)
    gain = problem.gain(without, rest, one)
    allowed = _TIED * problem.colour(found.solved.residual)
    tied: list[str] = []
    for k, other in enumerate(found.terms):
        if k in chosen or other.effect.id == term.effect.id or other.effect.id in tied:
            continue
        if gain - problem.gain(without, rest, k) < allowed:
            tied.append(other.effect.id)
    tied += [other for other in _left_out_of_the_torque(term, then, change) if other not in tied]
    advice = term.effect.distinguished_from(machines.effect_of(model, tied[0])) if tied else None
    evidence = {"likelihood_ratio": gain / max(problem.colour(found.solved.residual), 1e-300)}
    return NamedEffect(term.effect.id, term.axis, values, evidence, tied, advice)


def _left_out_of_the_torque(term: Term, then: Array, change: Array) -> list[str]:
    """Effects of the torque's measurement that make most of this one vanish by their law: feed-forward.

    Their response is that of the force they leave out, so no regression separates them from it.
    """
    whole = float(then[0]) + (1.0 if term.effect.domain is Domain.INERTIA else 0.0)
    sizes = sorted((abs(whole), abs(whole + float(change[0]))))
    if term.has_phase or sizes[0] > _VANISHED * sizes[1]:
        return []
    return [
        other.id
        for other in EFFECTS
        if other.domain is Domain.TORQUE_MEASUREMENT and term.effect.id in dict(other.alike)
    ]


def _hidden(found: _Found, least_Nm: float) -> list[Unobservable]:
    """Effects of which a change of a usual size would not have been detected."""
    problem = found.problem
    seen: dict[str, Unobservable] = {}
    for k, term in enumerate(found.terms):
        if k in found.chosen or term.has_phase or term.effect.id in seen:
            continue
        chosen = [*found.chosen, k]
        solved = problem.solved(chosen)
        error = float(np.sqrt(solved.covariance[-1, -1]))
        change = abs(float(solved.change[-1]))
        size = problem.size(solved, chosen, k) / change if change > 0.0 else 0.0
        smallest = max(_ERRORS * error, least_Nm / size if size > 0.0 else float("inf"))
        if not smallest <= term.size:
            visible = float(f"{smallest:.4g}") if np.isfinite(smallest) else None
            unit = term.effect.parameter(term.effect.strength[0]).unit
            seen[term.effect.id] = Unobservable(term.effect.id, term.axis, visible, unit, term.effect.shown_by)
    return list(seen.values())


def _as_now(found: _Found, simple: int) -> list[Term]:
    """The machine as it is in the later recording: what is simple of it, and what differs, within their bounds."""
    terms: list[Term] = []
    for k, term in enumerate(found.terms):
        if k >= simple and k not in found.chosen:
            continue
        coordinates = found.before(k) + (found.change(k) if k in found.chosen else 0.0)
        moved = term.at(np.concatenate([coordinates, term.coordinates()[term.linear :]]))
        slot = sum(other.place == term.place for other in terms)
        if slot < term.effect.slots:
            terms.append(replace(moved, slot=slot))
    return terms
