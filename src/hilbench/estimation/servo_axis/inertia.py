"""Inertia by a bank of Kalman filters (`kalman`), one for each hypothesis of when it last changed (`bank`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from hilbench.compiled import CUBE, INDICES, MATRIX, VECTOR, entry_point, number_of_sources
from hilbench.estimation import bank, correction
from hilbench.estimation.bank import Array, Places
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.servo_axis import kalman
from hilbench.estimation.servo_axis.balance import FilterInputs, ShaftSample
from hilbench.estimation.servo_axis.config import InertiaConfig
from hilbench.plant.servo_axis import kernel
from hilbench.plant.servo_axis import layout as lay
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

#: What is estimated beside the inertia, in the order of the filter's state.
_NAMES = (
    "torque_offset_Nm",
    "viscous_friction_Nm_s_per_rad",
    "coulomb_friction_Nm",
    "unbalance_sine_Nm",
    "unbalance_cosine_Nm",
)
#: A parameter counts as found when the data have shrunk its prior deviation to this share.
_FOUND = 0.7
#: Model's inertia over the one that is found, below which it is none.
_LEAST_BETA = 0.01

BankStep = Callable[[Array, Array, Array, Array, Array, Places, Array, Array], None]


def _compiled_step(sources: int) -> BankStep:
    """The function that is called from Python; `sources` as in `number_of_sources`."""

    @entry_point(MATRIX, CUBE, MATRIX, VECTOR, VECTOR, INDICES, MATRIX, MATRIX)
    def bank_step(
        z: Array, p: Array, records: Array, settings: Array, u: Array, places: Places, work: Array, out: Array
    ) -> None:
        """One cycle of all hypotheses. places: of all states; work (2·SIZE + 5, H): scratch; out (2, SIZE): means and
        standard deviations of the mixture."""
        if sources < 0:
            return
        size = z.shape[0]
        rows, g, likelihoods, shares = work[: size + 3], work[size + 5 :], work[size + 3], work[size + 4]
        kalman.step(z, p, u, places, g, rows, likelihoods)
        bank.weigh(records, likelihoods)
        bank.compare(records, shares)
        bank.mix(z, p, shares, places, out)
        bank.births(z, p, records, settings, kalman.BETA, kalman.RATE)

    return bank_step


_bank_step = _compiled_step(number_of_sources(kalman.__file__, correction.__file__, bank.__file__, __file__))


@dataclass(frozen=True, slots=True)
class ShaftEstimate:
    """Inertia and friction, and how sure the method is of them."""

    inertia_kg_m2: float
    deviation_kg_m2: float  #: standard deviation
    separable: bool  #: False: the motion has said (next to) nothing of the inertia yet
    #: Friction and offset as the shaft has them, the model's included; an unbalance is what is beyond the model's.
    also: tuple[Nuisance, ...] = ()


class InertiaEstimator:
    """Finds inertia and friction of an axis, one sample a cycle; `model` is where it starts."""

    def __init__(self, config: InertiaConfig, model: ServoAxisParameters) -> None:
        self._config = config
        self._inputs = FilterInputs(model, config)
        self._priors: list[float] = self._inputs.priors.tolist()
        p = lay.pack(model)
        self._of_model = np.zeros(kalman.TERMS)
        self._of_model[1] = model.shaft.viscous_friction_Nm_s_per_rad
        self._of_model[2] = model.shaft.coulomb_friction_Nm
        self._of_model[0] = kernel.look(p, 0.0)[2]
        self._places = np.arange(kalman.SIZE)
        self._z = np.zeros((kalman.SIZE, bank.CAPACITY))
        self._p = np.zeros((kalman.SIZE, kalman.SIZE, bank.CAPACITY))
        self._records = np.zeros((bank.CAPACITY, bank.RECORD))
        self._settings = np.zeros(bank.SETTINGS)
        self._settings[bank.JUMP_VARIANCE] = (0.01 * config.jump_pct) ** 2
        self._settings[bank.DRIFT_VARIANCE] = (0.01 * config.drift_pct_per_s) ** 2
        self._work = np.zeros((2 * kalman.SIZE + 5, bank.CAPACITY))
        self._out = np.zeros((2, kalman.SIZE))
        self._begin()

    def _begin(self) -> None:
        """At the model's inertia, as little sure of it as at the start."""
        self._records[:] = 0.0
        deviation = 0.01 * self._config.initial_deviation_pct
        kalman.new_filter(self._z, self._p, 0, deviation, self._inputs.priors)
        self._records[0, bank.ALIVE] = 1.0
        self._out[0] = self._z[:, 0]
        self._out[1] = np.sqrt(np.diag(self._p[:, :, 0]))
        self._lost = True  # the motion, not what is known of the shaft

    def update(self, sample: ShaftSample) -> ShaftEstimate:
        """One step of every hypothesis, and the births of the next."""
        usable = self._inputs.update(sample)
        self._lost = self._lost or self._inputs.lost
        if usable:
            if self._lost or self._inputs.in_doubt:
                speed = self._inputs.speed_rad_s
                kalman.place_motion(self._z, self._p, sample.position_rad - self._inputs.duration_s * speed, speed)
                self._lost = False
            c, settings = self._config, self._settings
            settings[bank.CYCLE] += 1.0
            bank.set_priors(settings, c.jumps_per_s, c.drift_onsets_per_s, self._inputs.duration_s)
            u, work = self._inputs.u, self._work
            _bank_step(self._z, self._p, self._records, settings, u, self._places, work, self._out)
            # No shaft turns against its torque: what says so (a strong ripple that the model lacks) has misled it.
            if not self._out[0, kalman.BETA] > _LEAST_BETA:
                self._begin()
        return self._estimate()

    def miss(self, duration_s: float) -> ShaftEstimate:
        """A cycle whose sample has not come: the next one is compared over all the time since the last."""
        self._inputs.miss()
        return self._less_sure(duration_s)

    def hold(self, duration_s: float) -> ShaftEstimate:
        """A time without a usable sample: what is known stays, less and less sure; the motion is found anew."""
        self._inputs.interrupt()
        return self._less_sure(duration_s)

    def _less_sure(self, duration_s: float) -> ShaftEstimate:
        self._lost = self._lost or self._inputs.lost
        walk = 0.01 * self._config.hold_growth_pct_per_s
        self._p[kalman.BETA, kalman.BETA] += walk**2 * duration_s
        self._out[1, kalman.BETA] = sqrt(self._out[1, kalman.BETA] ** 2 + walk**2 * duration_s)
        return self._estimate()

    def _estimate(self) -> ShaftEstimate:
        mean, deviation = self._out
        inertia = self._inputs.inertia_kg_m2 / mean.item(kalman.BETA)
        share = deviation.item(kalman.BETA) / mean.item(kalman.BETA)
        values, deviations = (mean[kalman.Q :] + self._of_model).tolist(), deviation[kalman.Q :].tolist()
        rows = zip(_NAMES, values, deviations, self._priors, strict=True)
        return ShaftEstimate(
            inertia,
            inertia * hypot(share, 0.01 * self._config.unmodelled_pct),
            share < _FOUND * 0.01 * self._config.initial_deviation_pct,
            tuple([Nuisance(n, v, d, d < _FOUND * prior) for n, v, d, prior in rows if prior > 0.0]),
        )
