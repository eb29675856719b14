"""Predictors in closed form, for tests of fit and search: what the right answer is follows from the formula."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from tests.plant.models import effect, lone_axis, model

from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.predictor import Predictor
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_analysis import Condition
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Term
from hilbench.plant.effects import find_effect
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.inverse import required_torque_Nm

Array = NDArray[np.float64]

PERIOD_S, SECONDS, NOISE = 0.005, 30.0, 0.05


class Analytic(Predictor):
    """One signal that is a formula of a parameter vector, measured with white noise of a known size."""

    def __init__(self, formula: Callable[[Array], Array], truth: Array, *, exact: bool = True, seed: int = 0) -> None:
        """formula: (P,) to (n,); truth: the parameter vector (P,) of what is measured."""
        self._formula = formula
        self.names = ("tau1_Nm",)
        clean = formula(truth)
        self.measured = (clean + NOISE * np.random.default_rng(seed).standard_normal(len(clean)))[None]
        self.rows = np.ones(len(clean), bool)
        self.exact = exact
        self.tolerances = np.zeros(1)

    def floor(self, signal: int) -> float:
        return NOISE

    def conditions(self, parameters: Array) -> list[Condition]:
        return []

    def predict(self, parameters: Array) -> Array:
        return np.array([self._formula(vector) for vector in np.atleast_2d(parameters)])[:, None, :]


class Axis:
    """A lone axis of 3 kg that is known to move to and fro at several speeds: torque equals force.

    rough_Nm: a torque of this size that turns with the others, a hundred times a N·m: sums of squares have many minima.
    """

    def __init__(
        self,
        *effects: dict[str, object],
        forward: bool = False,
        seed: int = 0,
        exact: bool = True,
        rough_Nm: float = 0.0,
    ) -> None:
        self.model = lone_axis()
        self._rough_Nm = rough_Nm
        self.t_s = np.arange(round(SECONDS / PERIOD_S)) * PERIOD_S
        phase = np.array([0.0, 0.4, 1.1, 2.0])
        omega = np.array([0.4, 1.3, 2.9, 6.1])
        wave = omega * self.t_s[:, None] + phase
        size = np.array([0.8, 0.5, 0.3, 0.2])
        self.v_m_s = np.sin(wave) @ size + (2.0 if forward else 0.0)
        self.a_m_s2 = np.cos(wave) @ (size * omega)
        self.x_m = -np.cos(wave) @ (size / omega) + (2.0 * self.t_s if forward else 0.0)
        self.space = Space(
            self.model, Analytic(self._torque_Nm, lay.pack(lone_axis(*effects)), seed=seed, exact=exact), PERIOD_S
        )  # type: ignore[arg-type]

    def _torque_Nm(self, parameters: Array) -> Array:
        out = np.empty(len(self.t_s))
        required_torque_Nm(parameters, self.x_m, self.v_m_s, self.a_m_s2, PERIOD_S, out)
        return out + self._rough_Nm * np.cos(100.0 * out)

    def proposer(self, *vocabulary: str) -> Proposer:
        """Of these effects only, in this order."""
        data = Measured(
            t_s=self.t_s,
            period_s=PERIOD_S,
            commands_m_s=np.empty((len(self.t_s), 0)),
            boundary=np.zeros((len(self.t_s), 2)),
            tau_Nm={1: self.space.predictor.measured[0]},
            x_m={1: self.x_m},
            v_m_s={1: self.v_m_s},
        )
        return Proposer(self.model, data, [find_effect(effect_id) for effect_id in vocabulary])

    def term(self, effect_id: str, **values: float) -> Term:
        """A term of an effect with these values, not searched for."""
        (first, *_) = self.proposer(effect_id).direct()
        return first.at(first.coordinates({**first.values, **values}))


class Ringing:
    """A web whose tension jumps with E at a time and rings at 20 Hz after it: a sum of squares with many minima."""

    def __init__(self, time_s: float, change: float, within_s: float = 0.0, ringing: float = 10.0) -> None:
        """`within_s`: how long E takes for the change; `ringing`: what a step of 1 makes at first, N·m."""
        self._ringing_Nm = ringing
        self.model = model()
        self.t_s = np.arange(round(SECONDS / PERIOD_S)) * PERIOD_S
        truth = lay.pack(self.model)
        values = {"time_s": time_s, "relative_change": change}
        if within_s > 0.0:
            lay.write_effect(truth, "elasticity_ramp", None, 0, {**values, "duration_s": within_s})
        else:
            lay.write_effect(truth, "elasticity_step", None, 0, values)
        self.space = Space(self.model, Analytic(self._torque_Nm, truth), PERIOD_S)  # type: ignore[arg-type]

    def proposer(self) -> Proposer:
        """Of steps and ramps of E."""
        data = Measured(
            t_s=self.t_s,
            period_s=PERIOD_S,
            commands_m_s=np.ones((len(self.t_s), 2)),
            boundary=np.zeros((len(self.t_s), 2)),
            tau_Nm={1: self.space.predictor.measured[0]},
            x_m={1: self.t_s, 2: self.t_s},
            v_m_s={},
        )
        return Proposer(self.model, data, [find_effect("elasticity_step"), find_effect("elasticity_ramp")])

    def _torque_Nm(self, parameters: Array) -> Array:
        (span,) = lay.Layout.of(parameters).span_rows(parameters)
        step_s, size = span.elasticity_step[0]
        since = self.t_s - step_s
        ringing = np.exp(-np.maximum(since, 0.0) / 0.3) * np.cos(2.0 * np.pi * 20.0 * since)
        sudden = np.where(since >= 0.0, size * (0.1 + self._ringing_Nm * ringing), 0.0)
        first, within, change = span.elasticity_ramp[0]
        begun, ended = np.maximum(self.t_s - first, 0.0), np.maximum(self.t_s - first - within, 0.0)
        return sudden + change * (self._so_far(begun) - self._so_far(ended)) / max(within, PERIOD_S)

    def _so_far(self, since_s: Array) -> Array:
        """The integral of what a step of 1 makes, up to so long after it."""
        pole = -1.0 / 0.3 + 2.0j * np.pi * 20.0
        return 0.1 * since_s + self._ringing_Nm * np.real(np.expm1(pole * since_s) / pole)


class Bent:
    """A torque offset whose law is bent, beside four effects that each look more like it than it does for a small
    change: of `size` times what bends it by a radian."""

    #: How much of what each of the others does is something else.
    _OTHER = 0.3
    _OTHERS = ("coulomb_friction", "viscous_friction", "quadratic_drag", "inertia_mismatch")

    def __init__(self, size: float, seed: int = 0) -> None:
        self._axis, self._radian_Nm = Axis(), 0.5
        phase = 2.0 * np.pi * self._axis.t_s
        self._carrier = phase / 3.0
        clean = self._turned(size)
        self._others = [clean + self._OTHER * np.sin((0.9 + 0.4 * k) * phase) for k in range(len(self._OTHERS))]
        self.strength_Nm = size * self._radian_Nm
        truth = lay.pack(lone_axis(effect("torque_offset", 1, offset_Nm=self.strength_Nm)))
        self._places = [self._place(effect_id) for effect_id in (*self._OTHERS, "torque_offset")]
        self.space = Space(self._axis.model, Analytic(self._torque_Nm, truth, seed=seed), PERIOD_S)  # type: ignore[arg-type]

    @staticmethod
    def _place(effect_id: str) -> int:
        """Of its strength in a parameter vector."""
        changed = lay.pack(lone_axis(effect(effect_id, 1, **{find_effect(effect_id).strength[0]: 0.1})))
        return int(np.flatnonzero(changed != lay.pack(lone_axis()))[0])

    def _turned(self, radian: float) -> Array:
        return np.asarray(np.cos(self._carrier + radian) - np.cos(self._carrier))

    def _torque_Nm(self, parameters: Array) -> Array:
        *others, offset_Nm = parameters[self._places]
        return self._turned(offset_Nm / self._radian_Nm) + np.asarray(others) @ np.array(self._others)

    def proposer(self) -> Proposer:
        """Of these five effects only."""
        return self._axis.proposer(*self._OTHERS, "torque_offset")
