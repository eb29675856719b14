"""A bank of Kalman filters, one for each hypothesis of when E last jumped or began to drift, mixed by evidence.

Bayesian change-point detection (Adams and MacKay 2007) with a filter of `kalman` as the model of a run, so that
a hypothesis is weighed by how well it predicts the next encoder position. Each young hypothesis is kept for a while,
whatever its weight, so that a small change has time to show; after that the least probable ones go. Between changes
the mixture is one long-run filter, and quiet; at a change the right hypothesis is already there, and takes over as
soon as the data prefer it. The deviation is that of the mixture: it says so while it is undecided.

Three kinds of child are born of the most probable hypothesis: a *jump* of E (large and small in turn), a *drift*
(a rate of E), and, of a drift, its *end*.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, hypot, log, sqrt

import numpy as np

from hilbench.compiled import compiled, entry_point, number_of_sources
from hilbench.estimation.config import ChangepointConfig
from hilbench.estimation.synchronizers import kalman
from hilbench.estimation.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.synchronizers.kalman import Array
from hilbench.estimation.synchronizers.plant import FilterInputs, Plant, nuisances

_JUMP, _DRIFT, _END = 0, 1, 2
#: Cycles between two births of a kind, and how long a newborn is kept whatever its weight.
_EVERY = (2, 50, 50)
_PROTECTED = (40, 500, 500)
#: Room for the young of every kind, and for those that have proved themselves.
_YOUNG = sum(kept // every + 1 for every, kept in zip(_EVERY, _PROTECTED, strict=True))
_CAPACITY = _YOUNG + 8
#: A hypothesis that has come of age goes when it is less probable than the best by this factor (logarithm).
_HOPELESS = 12.0
_SMALL_JUMP = 0.15  #: size of the small jumps over that of the large ones

# Columns of the hypotheses' records.
_WEIGHT, _KIND, _AGE, _ALIVE = range(4)
# What a step is told beside the inputs of the filters.
_LOG_JUMP, _LOG_DRIFT, _JUMP_VARIANCE, _DRIFT_VARIANCE, _CYCLE = range(5)


@compiled
def _free_place(records: Array) -> int:
    """Place of a hypothesis that may go; -1: all are needed."""
    worst = -1
    for i in range(records.shape[0]):
        if records[i, _ALIVE] == 0.0:
            return i
        of_age = records[i, _AGE] >= _PROTECTED[int(records[i, _KIND])]
        if of_age and (worst < 0 or records[i, _WEIGHT] < records[worst, _WEIGHT]):
            worst = i
    return worst


@compiled
def _best(records: Array) -> int:
    best = -1
    for i in range(records.shape[0]):
        if records[i, _ALIVE] != 0.0 and (best < 0 or records[i, _WEIGHT] > records[best, _WEIGHT]):
            best = i
    return best


@compiled
def _birth(
    z: Array, p: Array, records: Array, kind: int, log_prior: float, e_variance: float, rate_variance: float
) -> None:
    """A child of the best hypothesis, with these variances added to its E and set for its rate."""
    parent = _best(records)
    i = _free_place(records)
    if i < 0 or i == parent:
        return
    for j in range(kalman.SIZE):
        z[i, j] = z[parent, j]
        for k in range(kalman.SIZE):
            p[i, j, k] = p[parent, j, k]
    z[i, kalman.RATE] = 0.0
    for j in range(kalman.SIZE):
        p[i, kalman.RATE, j] = 0.0
        p[i, j, kalman.RATE] = 0.0
    p[i, kalman.E, kalman.E] += e_variance
    p[i, kalman.RATE, kalman.RATE] = rate_variance
    records[i, _WEIGHT] = records[parent, _WEIGHT] + log_prior
    records[i, _KIND] = kind
    records[i, _AGE] = 0.0
    records[i, _ALIVE] = 1.0


@compiled
def _births(z: Array, p: Array, records: Array, settings: Array) -> None:
    cycle = int(settings[_CYCLE])
    if cycle % _EVERY[_JUMP] == 0:
        size = _SMALL_JUMP if cycle // _EVERY[_JUMP] % 2 else 1.0
        _birth(z, p, records, _JUMP, settings[_LOG_JUMP], settings[_JUMP_VARIANCE] * size * size, 0.0)
    if cycle % _EVERY[_DRIFT] == 0:
        _birth(z, p, records, _DRIFT, settings[_LOG_DRIFT], 0.0, settings[_DRIFT_VARIANCE])
    if cycle % _EVERY[_END] == _EVERY[_END] // 2:
        best = _best(records)
        if p[best, kalman.RATE, kalman.RATE] > 0.0:
            _birth(z, p, records, _END, settings[_LOG_DRIFT], 0.0, 0.0)


BankStep = Callable[[Array, Array, Array, Array, Array, Array, Array], None]


def _compiled_step(sources: int) -> BankStep:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point
    def bank_step(z: Array, p: Array, records: Array, settings: Array, u: Array, row: Array, out: Array) -> None:
        """One cycle of all hypotheses. `out` (3, SIZE): means and standard deviations of the mixture, and, of E,
        the deviation that comes from noise alone."""
        count, size = records.shape[0] if sources >= 0 else 0, kalman.SIZE
        best_weight = -1e300
        for i in range(count):
            if records[i, _ALIVE] != 0.0:
                records[i, _WEIGHT] += kalman.step(z, p, i, u, row)
                records[i, _AGE] += 1.0
                best_weight = max(best_weight, records[i, _WEIGHT])
        total = 0.0
        for i in range(count):
            if records[i, _ALIVE] != 0.0:
                records[i, _WEIGHT] -= best_weight
                if records[i, _WEIGHT] < -_HOPELESS and records[i, _AGE] >= _PROTECTED[int(records[i, _KIND])]:
                    records[i, _ALIVE] = 0.0
                else:
                    total += exp(records[i, _WEIGHT])
        for j in range(size):
            out[0, j] = 0.0
            out[1, j] = 0.0
        out[2, kalman.E] = 0.0
        for i in range(count):
            if records[i, _ALIVE] != 0.0:
                share = exp(records[i, _WEIGHT]) / total
                for j in range(size):
                    out[0, j] += share * z[i, j]
        for i in range(count):
            if records[i, _ALIVE] != 0.0:
                share = exp(records[i, _WEIGHT]) / total
                for j in range(size):
                    out[1, j] += share * (p[i, j, j] + (z[i, j] - out[0, j]) ** 2)
                apart = z[i, kalman.E] - out[0, kalman.E]
                out[2, kalman.E] += share * (kalman.spread_of_e(p, i) + apart * apart)
        for j in range(size):
            out[1, j] = sqrt(max(out[1, j], 0.0))
        out[2, kalman.E] = sqrt(out[2, kalman.E])
        _births(z, p, records, settings)

    return bank_step


_bank_step = _compiled_step(number_of_sources(kalman.__file__, __file__))


class ChangepointSynchronizer:
    """The bank."""

    def __init__(self, config: ChangepointConfig, plant: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        self._inputs = FilterInputs(plant, config)
        self._z = np.zeros((_CAPACITY, kalman.SIZE))
        self._p = np.zeros((_CAPACITY, kalman.SIZE, kalman.SIZE))
        self._records = np.zeros((_CAPACITY, 4))
        self._settings = np.zeros(5)
        self._settings[_JUMP_VARIANCE] = (0.01 * config.jump_pct) ** 2
        self._settings[_DRIFT_VARIANCE] = (0.01 * config.drift_pct_per_s) ** 2
        self._inputs.u[kalman.E_VARIANCE_PER_S] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self._row = np.zeros(kalman.SIZE)
        self._out = np.zeros((3, kalman.SIZE))
        self._told = 1.0
        self._started = False

    def update(self, sample: SyncSample) -> Estimate:
        """One cycle of every hypothesis, and the births of the next."""
        if not self._started:
            self._start(sample)
        if self._inputs.update(sample):
            c, settings = self._config, self._settings
            settings[_CYCLE] += 1.0
            settings[_LOG_JUMP] = log(c.jumps_per_s * _EVERY[_JUMP] * sample.cycle_s)
            settings[_LOG_DRIFT] = log(c.drift_onsets_per_s * _EVERY[_DRIFT] * sample.cycle_s)
            _bank_step(self._z, self._p, self._records, settings, self._inputs.u, self._row, self._out)
            # A few samples after a jump the mixture still has the noise of a few samples.
            share = min(1.0, (0.01 * c.cautious_pct / self._out.item(2, kalman.E)) ** 2)
            self._told += share * (self._out.item(0, kalman.E) - self._told)
        return self._estimate()

    def _start(self, sample: SyncSample) -> None:
        c = self._config
        deviation = 0.01 * c.initial_deviation_pct
        kalman.new_filter(self._z, self._p, 0, sample.balance.x2_m, deviation, self._inputs.priors)
        self._records[0, _ALIVE] = 1.0
        self._out[0] = self._z[0]
        self._out[1] = np.sqrt(np.diag(self._p[0]))
        self._started = True

    def hold(self, duration_s: float) -> Estimate:
        """Let E walk in every hypothesis, and find position and velocity anew afterwards."""
        self._inputs.interrupt()
        walk = 0.01 * self._config.hold_growth_pct_per_s
        self._p[:, kalman.E, kalman.E] += walk**2 * duration_s
        kalman.lose_motion(self._p)
        self._out[1, kalman.E] = sqrt(self._out[1, kalman.E] ** 2 + walk**2 * duration_s)
        return self._estimate()

    def _estimate(self) -> Estimate:
        mean, deviation, _ = self._out.tolist()
        return Estimate(
            self._told * self._reference_Pa,
            hypot(deviation[kalman.E], mean[kalman.E] - self._told) * self._reference_Pa,
            nuisances(self._also, mean[kalman.OFFSET :], deviation[kalman.OFFSET :]),
        )
