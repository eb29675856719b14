"""E by a bank of Kalman filters (`kalman`), one for each hypothesis of when it last changed (`bank`)."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, sqrt

import numpy as np

from hilbench.compiled import entry_point, number_of_sources
from hilbench.estimation import bank, correction
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.web_line.config import ChangepointConfig
from hilbench.estimation.web_line.synchronizers import kalman
from hilbench.estimation.web_line.synchronizers.base import Estimate, SyncSample
from hilbench.estimation.web_line.synchronizers.plant import SEPARABLE, FilterInputs, Plant, nuisances

BankStep = Callable[[Array, Array, Array, Array, Array, Places, Array, Array, Array, bool], None]


def _compiled_step(sources: int) -> BankStep:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point
    def bank_step(
        z: Array,
        p: Array,
        records: Array,
        settings: Array,
        u: Array,
        places: Places,
        work: Array,
        out: Array,
        covariance: Array,
        beside: bool,
    ) -> None:
        """One cycle of all hypotheses. places: as of `kalman.step`; work (SIZE + 6, H): scratch. `out` (3, SIZE): means
        and standard deviations of the mixture, and, of E, the deviation that comes from noise alone; covariance
        (SIZE, SIZE) of the mixture, if E has something `beside` it."""
        if sources < 0:
            return
        size = z.shape[0]
        g, likelihoods, shares = work[size + 3], work[size + 4], work[size + 5]
        kalman.step(z, p, u, places, g, work, likelihoods)
        bank.weigh(records, likelihoods)
        bank.compare(records, shares)
        bank.mix(z, p, shares, places, out)
        if beside:
            bank.covariance(z, p, shares, out[0], covariance)
        variance = 0.0
        for i in range(len(shares)):
            if shares[i] != 0.0:
                apart = z[kalman.E, i] - out[0, kalman.E]
                variance += shares[i] * (kalman.spread_of_e(p, i) + apart * apart)
        out[2, kalman.E] = sqrt(variance)
        bank.births(z, p, records, settings, kalman.E, kalman.RATE)

    return bank_step


_bank_step = _compiled_step(number_of_sources(kalman.__file__, correction.__file__, bank.__file__, __file__))


class ChangepointSynchronizer:
    """The bank."""

    def __init__(self, config: ChangepointConfig, plant: Plant) -> None:
        self._config = config
        self._also = tuple(config.also)
        self._reference_Pa = plant.youngs_modulus_Pa
        self._inputs = FilterInputs(plant, config)
        self._places = kalman.places_of(self._inputs.priors)
        self._z = np.zeros((kalman.SIZE, bank.CAPACITY))
        self._p = np.zeros((kalman.SIZE, kalman.SIZE, bank.CAPACITY))
        self._records = np.zeros((bank.CAPACITY, bank.RECORD))
        self._settings = np.zeros(bank.SETTINGS)
        self._settings[bank.JUMP_VARIANCE] = (0.01 * config.jump_pct) ** 2
        self._settings[bank.DRIFT_VARIANCE] = (0.01 * config.drift_pct_per_s) ** 2
        self._inputs.u[kalman.E_VARIANCE_PER_S] = (0.01 * config.wander_pct_per_sqrt_s) ** 2
        self._work = np.zeros((kalman.SIZE + 6, bank.CAPACITY))
        self._out = np.zeros((3, kalman.SIZE))
        # Before the first sample E is what is believed at the start.
        self._out[0, kalman.E], self._out[1, kalman.E] = 1.0, 0.01 * config.initial_deviation_pct
        self._covariance = np.zeros((kalman.SIZE, kalman.SIZE))
        self._beside = bool(self._inputs.priors[:-1].any())
        self._told = 1.0
        self._found = 1.0
        self._started = False

    def update(self, sample: SyncSample) -> Estimate:
        """One cycle of every hypothesis, and the births of the next."""
        if not self._started:
            self._start(sample)
        if self._inputs.update(sample):
            c, settings = self._config, self._settings
            settings[bank.CYCLE] += 1.0
            bank.set_priors(settings, c.jumps_per_s, c.drift_onsets_per_s, sample.cycle_s)
            _bank_step(
                self._z,
                self._p,
                self._records,
                settings,
                self._inputs.u,
                self._places,
                self._work,
                self._out,
                self._covariance,
                self._beside,
            )
            self._found = self._out.item(0, kalman.E) - (self._of_what_is_held() if self._beside else 0.0)
            # A few samples after a jump the mixture still has the noise of a few samples.
            share = min(1.0, (0.01 * c.cautious_pct / self._out.item(2, kalman.E)) ** 2)
            self._told += share * (self._found - self._told)
        return self._estimate()

    def _of_what_is_held(self) -> float:
        """What E has of the parameters beside it that the data don't tell from it: those count as 0, their prior."""
        priors, deviations = self._inputs.priors, self._out[1, kalman.OFFSET :]
        held = kalman.OFFSET + np.flatnonzero((priors > 0.0) & (deviations >= SEPARABLE * priors))
        if not held.size:
            return 0.0
        gain = np.linalg.solve(self._covariance[np.ix_(held, held)], self._covariance[held, kalman.E])
        return float(gain @ self._out[0, held])

    def _start(self, sample: SyncSample) -> None:
        c = self._config
        deviation = 0.01 * c.initial_deviation_pct
        kalman.new_filter(self._z, self._p, 0, sample.balance.x2_m, deviation, self._inputs.priors)
        self._records[0, bank.ALIVE] = 1.0
        self._out[0] = self._z[:, 0]
        self._out[1] = np.sqrt(np.diag(self._p[:, :, 0]))
        self._found = self._out.item(0, kalman.E)
        self._started = True

    def rebase(self, change_Pa: float) -> None:
        """Move E of every hypothesis."""
        change = change_Pa / self._reference_Pa
        self._z[kalman.E] += change
        self._out[0, kalman.E] += change
        self._found += change
        self._told += change

    def hold(self, duration_s: float) -> Estimate:
        """Let E walk in every hypothesis, and find position and velocity anew afterwards."""
        self._inputs.interrupt()
        walk = 0.01 * self._config.hold_growth_pct_per_s
        self._p[kalman.E, kalman.E] += walk**2 * duration_s
        kalman.lose_motion(self._p)
        self._out[1, kalman.E] = sqrt(self._out[1, kalman.E] ** 2 + walk**2 * duration_s)
        return self._estimate()

    def _estimate(self) -> Estimate:
        mean, deviation, _ = self._out.tolist()
        return Estimate(
            self._told * self._reference_Pa,
            hypot(deviation[kalman.E], self._found - self._told) * self._reference_Pa,
            nuisances(self._also, mean[kalman.OFFSET :], deviation[kalman.OFFSET :]),
        )
