"""Splice detection: other web entering a span, separated from a change of E of the web in it.

A span that a joint passes through is two springs in series: its compliance goes from the old web's to the new web's
with the travel s of the joint through the length L. The encoders show less than that, as they are followed as if the
leaving web were like the rest. Apparent compliance, relative to the old one:

    web of another E from the joint on:     b·(1 − exp(−s/L))        b = E_old/E_new − 1
    short piece of other web:               β·exp(−s/L)              β = b·(its length)/L
    E of the web that is in the span:       a step

to the first order in the change, and within 0.2 % of the compliance for one by 20 %. Block means are compared with
these three by their likelihood ratio, for every joint position that the last blocks can resolve. Where the speed has
changed, friction and inertia errors of the model show as a compliance that goes with speed or acceleration: these
regressors are included as no joint. The acceleration is held while it differs by noise alone: in a ramp that noise is
in the compliance, too, and would show an inertia error of some 50 %, whose end is other web.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence, Set
from dataclasses import dataclass
from math import exp, inf
from typing import Final, NamedTuple

import numpy as np

from hilbench.arrays import Array, Vector
from hilbench.compiled import MATRIX, VECTOR, Record, compiled, entry_point, interpreted, record_type, viewed
from hilbench.estimation.web_line.balance import BalanceSample
from hilbench.estimation.web_line.block_means import BLOCK_S, SAME_SPEED

#: Interval of the evaluation, s, and the largest and least number of blocks used.
_LOOK_S = 0.1
_MOST, _FEWEST = 400, 40
#: Blocks needed before a joint and after it. Joint positions are tried at each of the last blocks, as a step some
#: blocks off its true position is taken for other web, and at some earlier ones.
_BEFORE, _BEHIND, _LATEST, _EARLIER = 15, 2, 90, 15
#: Twice the log likelihood ratio: a change is certain; one explanation beats another; a change is suspected.
_CHANGED, _BETTER, _SUSPECTED = 45.0, 16.0, 25.0
#: Travel of a joint through the span, in lengths, from which on it is separable from a step, and up to which its
#: estimate improves.
_LEAST_TRAVEL, _THROUGH = 0.12, 1.0
#: Change of the acceleration that is no noise, in its standard deviations: once in 16,000 blocks otherwise.
_SAME_NOISES = 4.0
#: Assumed length of a short piece, m, and the largest share of the span's compliance change it may have.
_SHORT_M, _LEAST_SHARE = 0.3, 0.5


#: Sums over a block: cycles so far, cycles of a block, forces, h (`balance`) as it seems, positions of the roller
#: before the span; its first speed.
SUMS: Final = record_type("count", "cycles", "forces_N", "webs", "travels_m", "first_m_s")


@compiled
def interrupt(s: Record) -> None:
    """Start a new block; s: its sums."""
    s.count = s.forces_N = s.webs = s.travels_m = s.first_m_s = 0.0


@compiled
def collect(s: Record, force_N: float, web_per_Pa: float, velocity_m_s: float, before_m: float) -> bool:
    """Add a cycle's balance, with h as it seems and the position of the roller before the span; True if the block is
    complete."""
    if s.count == 0.0:
        s.first_m_s = velocity_m_s
    s.forces_N += force_N
    s.webs += web_per_Pa
    s.travels_m += before_m
    s.count += 1.0
    return bool(s.count >= s.cycles)


#: Kinds of change, and shapes of the compliance: E of the web in the span, the web that comes in, a short piece of it.
_STEP, _WEB, _SHORT, _KINDS = range(4)
#: Best fit of a shape over joint positions: squares explained, position index, change, and mean of the shape.
_FOUND: Final = record_type("explained", "place", "change", "mean")


@entry_point(VECTOR, VECTOR, MATRIX, VECTOR, MATRIX)
def _explain_all(travels: Vector, values: Vector, motion: Array, fronts: Vector, best: Array) -> None:
    """Best least squares of values (n,) as a shape of each kind times its change, orthogonal to orthonormal rows
    (k, n): `_FOUND` of each kind. Travels (n,) and `fronts` (m,) in lengths of the span."""
    count, of_values, of_shape = len(values), np.zeros(len(motion)), np.zeros(len(motion))
    shapes = np.zeros((_KINDS, count))  # compliance relative to the change of the whole span's
    for k in range(len(motion)):
        for j in range(count):
            of_values[k] += motion[k, j] * values[j]
    for kind in range(_KINDS):
        viewed(best[kind], _FOUND)[0].explained = -1.0
    for place in range(len(fronts)):
        for j in range(count):
            into = travels[j] - fronts[place]
            left = exp(-into) if into > 0.0 else 0.0
            shapes[_STEP, j] = 1.0 if into > 0.0 else 0.0
            shapes[_WEB, j], shapes[_SHORT, j] = shapes[_STEP, j] - left, left
        for kind in range(_KINDS):
            shape, found, squares, product, total = shapes[kind], viewed(best[kind], _FOUND)[0], 0.0, 0.0, 0.0
            for j in range(count):
                squares += shape[j] * shape[j]
                product += shape[j] * values[j]
                total += shape[j]
            for k in range(len(motion)):
                of_shape[k] = 0.0
                for j in range(count):
                    of_shape[k] += shape[j] * motion[k, j]
                squares -= of_shape[k] * of_shape[k]
                product -= of_shape[k] * of_values[k]
            squares = max(squares, 1e-12)
            change = product / squares
            if change * change * squares > found.explained:
                found.explained, found.place = change * change * squares, place
                found.change, found.mean = change, total / count


_interrupt, _collect = interpreted(interrupt), interpreted(collect)


class Joint(NamedTuple):
    """Splice that has entered: position of the roller before the span then, m; relative change of E; length of the
    piece, m (inf: endless)."""

    front_m: float
    relative_change: float
    length_m: float


@dataclass(frozen=True, slots=True)
class Entered:
    """Splice in the span, and the ratio of the true strain to the apparent one.

    Without a joint there was none: `relative_change` is that of E of the web in the span.
    """

    joint: Joint | None
    strain_ratio: float = 1.0
    relative_change: float = 0.0


#: Accepted compliance changes of the whole span, softer and stiffer, by kind.
_SHARES: Final = ((2.0, -0.7), (1.0, -0.5), (0.3, -0.3))


class _Fit(NamedTuple):
    gain: float  #: twice the log likelihood ratio to no change
    front_m: float
    share: float  #: change of the compliance


class SpliceFinder:
    """Splice detector on the momentum balances of one span."""

    def __init__(self, span_length_m: float, mass_kg: float, cycle_s: float) -> None:
        self._length_m = span_length_m
        self._mass_kg = mass_kg
        cycles = max(2, round(BLOCK_S / cycle_s))
        self.sums = np.zeros(1, SUMS)  #: for compiled callers
        self.sums["cycles"] = cycles
        self._sums = self.sums.view(np.recarray)[0]
        self._block_s = cycles * cycle_s
        self._every = max(1, round(_LOOK_S / self._block_s))
        self.reset()

    def reset(self) -> None:
        """Forget all blocks and the joint."""
        #: Of each block: position of the roller before the span, m, seeming strain times section over tension, speed of
        #: the roller behind, m/s, and force that accelerates it over the tension.
        self._blocks: deque[tuple[float, float, float, float]] = deque(maxlen=_MOST)
        self._blocks_seen = 0
        self._since_m = -inf  # position of the roller before the span from which on blocks are looked at
        self._kind: int | None = None
        self._joint: Joint | None = None
        self.suspects = False  #: something has changed that may be inside, and it is open yet what
        _interrupt(self._sums)

    def update(self, now: BalanceSample | None, before_m: float, seeming: float) -> Entered | None:
        """Take this cycle's balance (None: unusable), the position of the roller before the span in m, and the ratio of
        the tension by the apparent strain to that of the balance. Returns a splice when it is found or better known; it
        stays the same one until `reset`."""
        if now is None:
            _interrupt(self._sums)
            return None
        if not _collect(self._sums, now.force_N, now.web_per_Pa * seeming, now.velocity_m_s, before_m):
            return None
        count, _, force_N, web, travel_m, first_m_s = self._sums.item()
        gained_N = self._mass_kg * (now.velocity_m_s - first_m_s) / ((count - 1) * self._block_s / count)
        tension_N = force_N / count - gained_N
        travel_m, web = travel_m / count, web / count
        _interrupt(self._sums)
        if not tension_N > 0.0:
            self._blocks.clear()
            return None
        self._blocks.append((travel_m, web / tension_N, now.velocity_m_s, gained_N / tension_N))
        self._blocks_seen += 1
        if self._blocks_seen % self._every or len(self._blocks) < _FEWEST:
            return None
        return self._look()

    def _look(self) -> Entered | None:
        blocks = np.array(self._blocks)
        self._choose_since(blocks)
        travels_m, compliances, speeds_m_s, accelerating = blocks[blocks[:, 0] > self._since_m].T
        noise = _noise(compliances)
        if not noise > 0.0:
            return None
        fronts_m = _fronts_m(travels_m)
        motion = _known_regressors(speeds_m_s, accelerating)
        fits = self._fits(travels_m, compliances, motion, fronts_m, noise)
        # The residual of the best fit, e.g. of a roller hit by a step, counts as noise.
        total = float(np.sum(_without(compliances, motion) ** 2)) / noise**2
        rest = (total - max(fit.gain for fit in fits)) / len(compliances)
        inside_yet = [fit.gain for fit in fits if travels_m[-1] - fit.front_m < _THROUGH * self._length_m]
        self.suspects = max(inside_yet, default=0.0) > _SUSPECTED * max(rest, 1.0)
        # The compliance change is a web's, and the joint so far in that it is separable from a step.
        entered_m = float(travels_m[-1]) - _LEAST_TRAVEL * self._length_m
        likely = [stiffer < fit.share < softer for fit, (softer, stiffer) in zip(fits, _SHARES, strict=True)]
        identifiable = {kind for kind in range(_KINDS) if likely[kind] and entered_m > fits[kind].front_m}
        if not self._decide([fit.gain / max(rest, 1.0) for fit in fits], identifiable):
            return None
        kind = self._kind
        assert kind is not None, "it was decided"
        if kind is _STEP:
            self._forget_before(fits[kind].front_m)
            if self._joint is None:
                return None
            self._joint = None
            return Entered(None, relative_change=1.0 / (1.0 + fits[kind].share) - 1.0)
        travel_share = (float(travels_m[-1]) - fits[kind].front_m) / self._length_m
        if travel_share > _THROUGH:
            if self._joint is None:  # too late: all of the span is the new web, whose E is known
                self._forget_before(fits[kind].front_m)
            return None
        return self._entered(fits[kind], travel_share)

    def _fits(self, travels_m: Array, compliances: Array, motion: Array, fronts_m: Array, noise: float) -> list[_Fit]:
        """Best least-squares fit of a + b·shape + motion for each kind; motion (n, k): as of `_known_regressors`."""
        values, rows = np.ascontiguousarray(compliances), np.ascontiguousarray(motion.T)
        best, mean, fits = np.zeros(_KINDS, _FOUND), float(values.mean()), []
        of_kinds = best.view(np.float64).reshape(_KINDS, -1)
        _explain_all(travels_m / self._length_m, values, rows, fronts_m / self._length_m, of_kinds)
        for explained, place, change, of_shape in best.tolist():
            share = change / (mean - change * of_shape)
            fits.append(_Fit(explained / noise**2, float(fronts_m[int(place)]), share))
        return fits

    def _decide(self, gains: Sequence[float], identifiable: Set[int]) -> bool:
        """Select the explanation by the likelihood gains, among the identifiable ones; True if there is one.

        A short piece that has just come in is like a step: what is uncertain keeps its kind.
        """
        best, next_best = sorted(range(_KINDS), key=gains.__getitem__, reverse=True)[:2]
        if gains[best] < _CHANGED:
            return self._kind is not None
        than = next_best
        if self._kind is not None and best is not _STEP:
            than = self._kind if best is not self._kind else next_best
        if best in identifiable and gains[best] > gains[than] + _BETTER:
            self._kind = best
        return self._kind in identifiable

    def _forget_before(self, front_m: float) -> None:
        """Drop the blocks before a step."""
        kept = [block for block in self._blocks if block[0] > front_m]
        self._blocks.clear()
        self._blocks.extend(kept)
        self._kind, self.suspects = None, False

    def _choose_since(self, blocks: Array) -> None:
        """Use blocks before the last change of speed only while web from before it is in the span: the earlier ones
        then identify the influence of the motion."""
        speeds_m_s, now_m = blocks[:, 2], blocks[-1, 0]
        others = np.flatnonzero(np.abs(speeds_m_s - speeds_m_s[-1]) > SAME_SPEED * abs(speeds_m_s[-1]))
        last = int(others[-1]) if len(others) else -1
        changed_m = blocks[last, 0] if last >= 0 else -inf
        if now_m - changed_m < _THROUGH * self._length_m or len(blocks) - last <= _FEWEST:
            self._since_m = -inf
        elif self._joint is None and not self.suspects:
            self._since_m = changed_m

    def _entered(self, found: _Fit, travel_share: float) -> Entered:
        """Splice as it is estimated now."""
        share, endless = found.share, self._kind is _WEB
        left = exp(-max(travel_share, 0.0))
        if endless:
            length_m, of_piece, acts, seems = inf, share, share * min(max(travel_share, 0.0), 1.0), share * (1.0 - left)
        else:
            length_m = max(_SHORT_M, abs(share) * self._length_m / _LEAST_SHARE)
            of_piece, acts, seems = share * self._length_m / length_m, share, share * left
        self._joint = Joint(found.front_m, 1.0 / (1.0 + of_piece) - 1.0, length_m)
        return Entered(self._joint, (1.0 + acts) / (1.0 + seems))


def _fronts_m(travels_m: Array) -> Array:
    """Candidate entry positions of a joint (m,), between blocks."""
    latest = np.arange(max(len(travels_m) - _BEHIND - _LATEST, _BEFORE), len(travels_m) - _BEHIND)
    earlier = np.linspace(_BEFORE, latest[0], min(_EARLIER, int(latest[0]) - _BEFORE), endpoint=False).astype(int)
    before = np.concatenate([earlier, latest])
    return np.asarray(0.5 * (travels_m[before] + travels_m[before + 1]))


def _known_regressors(speeds_m_s: Array, accelerating: Array) -> Array:
    """Orthonormal columns (n, 1 to 3) of compliance changes without a joint: constant, speed, acceleration."""
    regressors = [np.ones(len(speeds_m_s))]
    if np.ptp(speeds_m_s) > SAME_SPEED * np.max(np.abs(speeds_m_s)):
        regressors += [speeds_m_s, _held(accelerating, _SAME_NOISES * _noise(accelerating))]
    return np.linalg.qr(np.stack(regressors, axis=1))[0]


def _held(values: Array, change: float) -> Array:
    """Values (n,), each like the one before it unless it differs from that by more than this."""
    held, last = np.empty_like(values), inf
    for i, value in enumerate(values.tolist()):
        last = value if abs(value - last) > change else last
        held[i] = last
    return held


def _noise(values: Array) -> float:
    """Standard deviation of white noise of values (n,), by their successive differences."""
    return float(1.4826 * np.median(np.abs(np.diff(values))) / 2.0**0.5)


def _without(values: Array, regressors: Array) -> Array:
    """Values (..., n) less their projection on orthonormal columns (n, k)."""
    return np.asarray(values - (values @ regressors) @ regressors.T)
