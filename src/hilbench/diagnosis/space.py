"""Residuals and sensitivities at one model, whitened, with the stretches that a fit sees and those it doesn't."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.arrays import Array
from hilbench.diagnosis import machines
from hilbench.diagnosis.noise import ORDER, Whitening, scaling, whitening
from hilbench.diagnosis.predictor import Predictor, deviations_of
from hilbench.diagnosis.terms import Term, pack_with
from hilbench.plant.model_file import Machine

Rows = NDArray[np.int64]

#: Blocks a recording is cut into; every third is held out, so that each regime is on both sides. Which thirds are
#: tried, and how much of what changes in the recording (of its variance about the median) may be in those held out, as
#: how much of what the model does not explain may be where no fit sees it.
BLOCKS: Final = 12
_HELD_OUT_OF: Final = 3
_FIRST_HELD_OUT: Final = (1, 2, 0)
_MOST_HELD_OUT: Final = 0.6
#: Windows a block is cut into to see where the model disagrees, and the deviations of a mean square that are noise.
_WINDOWS: Final = 4
_CALM: Final = 4.0
#: Shortest block, s, and what is cut off both ends of a held-out one (about three web transports at 3 m/s), s. A lone
#: axis on its measured motion remembers no web, and may go for a second or two in each direction: its least blocks.
_SHORTEST_BLOCK_S: Final = 1.5
_EMBARGO_S: Final = 1.0
_LEAST_BLOCKS_OF_ONE_AXIS: Final = 6
#: Runs of the model that are held in memory at once: more than a machine has cores, less than its cache and pages.
_AT_ONCE: Final = 16
#: Bytes of predictions that are kept: a search comes back to the models that it has just been at.
_KEPT: Final = 64e6


@dataclass(frozen=True)
class Split:
    """Block of every row, -1 for none; which blocks are held out."""

    block: Rows
    held_out: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        rows: NDArray[np.bool_],
        period_s: float,
        first: int = 1,
        *,
        counted: bool = False,
        shortest_s: float = _SHORTEST_BLOCK_S,
        memory: int = 0,
    ) -> Split:
        """Contiguous blocks, equally long, or with `counted` of equally many rows that count.

        first: the first that is held out; memory: how many rows before it a whitened row holds.
        """
        n = len(rows)
        length_s = (np.count_nonzero(rows) if counted else n) * period_s
        count = int(np.clip(length_s / shortest_s, 3, BLOCKS))
        edges = np.linspace(0, n, count + 1).astype(int)
        if counted:
            so_far = np.cumsum(rows)
            edges[1:-1] = np.searchsorted(so_far, np.linspace(0, so_far[-1], count + 1)[1:-1])
        block = np.repeat(np.arange(count), np.diff(edges))
        held_out = np.arange(count) % _HELD_OUT_OF == first
        length = length_s / count
        embargo = int(min(_EMBARGO_S, 0.15 * length) / period_s)
        for b in np.flatnonzero(held_out):
            block[edges[b] : edges[b] + embargo] = -1
            block[edges[b + 1] - embargo : edges[b + 1]] = -1
        near = np.convolve(~rows, np.ones(memory + 1), "full")[:n] > 0.0
        block[near] = -1
        block[:memory] = -1
        return cls(block, held_out)

    @classmethod
    def balanced(
        cls,
        measured: Array,
        rows: NDArray[np.bool_],
        period_s: float,
        shortest_s: float = _SHORTEST_BLOCK_S,
        residual: Array | None = None,
        memory: int = 0,
    ) -> Split:
        """Split that holds out blocks without most of what changes in the signals (signals, n): a fit can't see the one
        ramp of a production run where that is held out.

        residual: measured less predicted (signals, n), in units of its noise: what comes once and goes (a splice) is
        not kept from the fit that shall find it either.
        Where equally long blocks leave no rows to one side (an axis that moves for a short while) each has as many.
        memory: as in `of`.
        """
        change = np.sum(_shares(measured, rows), axis=0)
        excess = np.zeros(len(rows)) if residual is None else _excess(residual, rows)
        splits = [cls.of(rows, period_s, first, shortest_s=shortest_s, memory=memory) for first in _FIRST_HELD_OUT]
        usable = [split for split in splits if np.any(split.test) and np.any(split.train)]
        if not usable:
            return cls.of(rows, period_s, counted=True, shortest_s=shortest_s, memory=memory)
        held_out = [np.sum(change[split.test]) / max(np.sum(change[split.block >= 0]), 1e-300) for split in usable]
        worse = np.maximum(held_out, [_unseen(excess, split) for split in usable])
        enough = np.flatnonzero(worse < _MOST_HELD_OUT)
        return usable[int(enough[0]) if len(enough) else int(np.argmin(worse))]

    @property
    def train(self) -> NDArray[np.bool_]:
        """Rows that fits see."""
        return (self.block >= 0) & ~self.held_out[np.maximum(self.block, 0)]

    @property
    def test(self) -> NDArray[np.bool_]:
        """Rows that no fit sees."""
        return (self.block >= 0) & self.held_out[np.maximum(self.block, 0)]


def _shares(measured: Array, rows: NDArray[np.bool_]) -> Array:
    """(signals, n): what each row has of a signal's variance about its median, on the rows that count."""
    square = (measured - np.median(measured[:, rows], axis=1, keepdims=True)) ** 2 * rows
    return np.asarray(square / np.maximum(np.sum(square, axis=1, keepdims=True), 1e-300))


def _excess(residual: Array, rows: NDArray[np.bool_]) -> Array:
    """(n,): excess of the squares of residuals (signals, n) of unit noise over what they are at other times,
    as the mean over a while; zero where that may be noise."""
    found = np.zeros(len(rows))
    for square in residual**2:
        windows = [part[rows[part]] for part in np.array_split(np.arange(len(rows)), BLOCKS * _WINDOWS)]
        windows = [part for part in windows if len(part)]
        mean = np.array([np.mean(square[part]) for part in windows])
        usual = min(float(np.median(mean)), 1.0)
        for part, value in zip(windows, mean, strict=True):
            found[part] += value - usual if value > usual * (1.0 + _CALM * (2.0 / len(part)) ** 0.5) else 0.0
    return found


def _unseen(excess: Array, split: Split) -> float:
    """Share of what is left beyond noise (n,) that no fit sees."""
    return float(np.sum(excess[~split.train]) / max(np.sum(excess), 1e-300))


@dataclass(frozen=True)
class Point:
    """One model: its terms, raw residuals (signals, n), and raw derivatives (coordinates, signals, n) by the terms."""

    terms: list[Term]
    residual: Array
    derivatives: Array


@dataclass
class Space:
    """A recording and a model to extend; evaluates points."""

    model: Machine
    predictor: Predictor
    period_s: float
    split: Split = field(init=False)
    before: Array = field(init=False)  #: residual (signals, n) of the model as it is
    simulations: int = 0
    _base: Array = field(init=False)  #: the model's parameter vector
    _quick: Array = field(init=False)  #: of the measured (signals, n), what terms make of the quick part of the motion
    _known: dict[bytes, Array] = field(init=False, default_factory=dict)  #: latest predictions, by parameter vector

    def __post_init__(self) -> None:
        self._base = machines.packed(self.model)
        self._quick = np.zeros_like(self.predictor.measured)
        self.before = self.residual([])
        self.split = self._balanced(self.before)

    def _balanced(self, residual: Array) -> Split:
        """Blocks of which those held out have little that only they have, by what is left (signals, n)."""
        exact, rows = self.predictor.exact, self.predictor.rows
        shortest_s = _SHORTEST_BLOCK_S
        if not exact:
            shortest_s = min(shortest_s, self.duration_s / _LEAST_BLOCKS_OF_ONE_AXIS)
        # Noise that is white is scaled, whatever was before it; the filter for another has a memory.
        memory = 0 if exact else ORDER
        left = scaling(deviations_of(self.predictor)).apply(residual) if exact else None
        row_s = self.period_s * self.predictor.every
        return Split.balanced(self.predictor.measured, rows, row_s, shortest_s, left, memory)

    def split_again(self, residual: Array) -> bool:
        """Hold other blocks out where what is left (signals, n) is nearly all where no fit sees it; true if it did.

        What is larger elsewhere may have hidden, when the blocks were chosen, that they hold out all of another effect.
        """
        excess = _excess(scaling(deviations_of(self.predictor)).apply(residual), self.predictor.rows)
        if _unseen(excess, self.split) < _MOST_HELD_OUT:
            return False
        split = self._balanced(residual)
        if np.array_equal(split.block, self.split.block):
            return False
        self.split = split
        return True

    @property
    def duration_s(self) -> float:
        """Length of the recording."""
        return len(self.predictor.rows) * self.period_s * self.predictor.every

    def packed(self, terms: list[Term]) -> Array:
        """The parameter vector of the model with these terms."""
        return pack_with(self.model, terms, self._base)

    def residual(self, terms: list[Term]) -> Array:
        """Measured minus predicted, (signals, n)."""
        found: Array = self.residuals([terms])[0]
        return found

    def residuals(self, variants: list[list[Term]]) -> Array:
        """(variants, signals, n)."""
        keys = [self.packed(terms).tobytes() for terms in variants]
        new = [key for key in dict.fromkeys(keys) if key not in self._known]
        self.simulations += len(new)
        known = self.predictor.measured - self._quick
        for first in range(0, len(new), _AT_ONCE):
            part = new[first : first + _AT_ONCE]
            with np.errstate(over="ignore", invalid="ignore"):  # a model far off may run away; fits see that
                predicted = self.predictor.predict(np.array([np.frombuffer(key) for key in part]))
            self._known |= dict(zip(part, predicted, strict=True))
        found = np.array([known - self._known[key] for key in keys]).reshape(-1, *known.shape)
        for key in list(self._known)[: max(len(self._known) - int(_KEPT / max(known.nbytes, 1)), 0)]:
            del self._known[key]
        return found

    def settle(self, terms: list[Term]) -> bool:
        """Take the quick part of a measured motion's torque from the model with these terms from now on; true if there
        is one.

        What terms change follows from its calm part; at the corners of a ramp another inertia, or another scale of the
        torque, is as far off in the quick part as in the calm one, and would be left over.
        """
        quick = self.predictor.quick(self.packed(terms))
        self._quick = self._quick if quick is None else quick
        return quick is not None

    def residual_with_force(self, terms: list[Term], force_N: float, time_s: float) -> Array:
        """The residual with a force as in `Predictor.with_force`."""
        self.simulations += 1
        predicted = self.predictor.with_force(force_N, time_s).predict(self.packed(terms)[None])
        return np.asarray(self.predictor.measured - self._quick - predicted[0], np.float64)

    def doubts(self, terms: list[Term]) -> Array:
        """(shapes, signals, n): errors of a right prediction in addition to noise, each to one standard deviation."""
        return self.predictor.doubts(self.packed(terms))

    def point(self, terms: list[Term], residual: Array | None = None, *, timeless: bool = False) -> Point:
        """Residual (if it is not known) and derivatives by all coordinates of the terms, by forward differences.

        `timeless`: those by times that have been searched for are zero.
        """
        variants: list[list[Term]] = []
        steps: list[float] = []
        free = [not (timeless and term.stays_at(name)) for term in terms for name in term.free()]
        for place, term in enumerate(terms):
            for k, (step, name) in enumerate(zip(term.steps(), term.free(), strict=True)):
                if not (timeless and term.stays_at(name)):
                    variants.append([*terms[:place], term.stepped(k, step), *terms[place + 1 :]])
                    steps.append(step)
        if residual is None:
            variants.append(terms)
        found = self.residuals(variants) if variants else np.empty((0, *self.predictor.measured.shape))
        here_residual = found[-1] if residual is None else residual
        moved_residuals = found[: len(steps)]
        derivatives = np.zeros((len(free), *here_residual.shape))
        derivatives[free] = (here_residual - moved_residuals) / np.array(steps)[:, None, None]
        return Point(terms, here_residual, derivatives)

    @cached_property
    def _surrogate(self) -> Space | None:
        predictor = self.predictor.surrogate
        return None if predictor is None else Space(self.model, predictor, self.period_s)

    def strengths(self, terms: list[Term], residual: Array, candidates: list[Term]) -> list[Array]:
        """Derivatives by the strength of each candidate (1 or 2 coordinates), added to a model with `terms`.

        `residual` is the one of that model. By the prediction's surrogate: they choose what is then fitted.
        """
        if (near := self._surrogate) is not None:
            responses = near.strengths(terms, near.residual(terms), candidates)
            self.simulations, near.simulations = self.simulations + near.simulations, 0
            return responses
        looked_at = [(one.neutral(), k, probe) for one in candidates for k, probe in enumerate(one.probes())]
        found = iter(self.residuals([[*terms, neutral.stepped(k, probe)] for neutral, k, probe in looked_at]))
        return [np.array([(residual - next(found)) / probe for probe in one.probes()]) for one in candidates]


def noise_model(space: Space, residual: Array, columns: Array) -> Whitening:
    """Whitening of the noise: its floor where a right model leaves white noise, else its colour.

    residual: measured less predicted (signals, n); columns: raw responses (J, signals, n). The colour is that of the
    residual after every column has had its say; each signal is scaled first, and a small ridge keeps collinear columns
    calm.
    """
    predictor = space.predictor
    if predictor.exact:
        return scaling(deviations_of(predictor))
    rows = predictor.rows
    scale = np.maximum(np.std(np.diff(residual[:, rows], axis=-1), axis=-1), 1e-300)
    r = (residual / scale[:, None])[:, rows].reshape(-1)
    c = (columns / scale[None, :, None])[:, :, rows].reshape(len(columns), -1)
    size = np.sqrt(np.einsum("ij,ij->i", c, c))
    used = size > 0.0
    c = c[used] / size[used, None]
    theta = np.linalg.solve(c @ c.T + 1e-6 * np.eye(len(c)), c @ r)
    return whitening((r - theta @ c).reshape(len(residual), -1) * scale[:, None])
