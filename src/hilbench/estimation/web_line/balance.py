"""Momentum balance of the roller after the first span, on measured motion and torque.

    m·v2' = (i/r)·τ2 + F_next − R2(v2) − F,   F = E·h          (design section 5)

Everything but E is measured or in the model, effects included, so each cycle has information on E: h = F/E is the web's
section times its strain by the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hilbench.compiled import compiled
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.span import SpanFollower
from hilbench.plant.web_line.span_kernel import SpanVectors, follow_to, modulus_place, put_boundary

_AXIS = 1  #: index of axis 2
_CREEP = lay.place("web_slip", "creep_per_N")
#: Relative change of E that is passed to the follower: its creep and damping depend on it.
_WORTH_TELLING = 1e-4


@dataclass(slots=True)
class BalanceSample:
    """One instant of the balance; forces at the web."""

    x2_m: float  #: measured position of roller 2; of several rollers as one, of their centre of mass
    force_N: float  #: (i/r)·τ2 + F_next − R2(v2), with the model's effects
    web_per_Pa: float  #: ∂F/∂E in N/Pa: section times strain; 0 while the web is slack
    velocity_m_s: float  #: of roller 2, from two positions


class BalanceVectors(NamedTuple):
    """Vectors of a `MeasuredBalance`, for compiled callers."""

    p: Vector  #: parameters of the two rollers
    web: SpanVectors
    s: Vector  #: state: STARTED, BEFORE_M, and the last `BalanceSample`


# State of a balance: phase (_BEGUN: the web was placed in this cycle) and previous position; then the fields of a
# `BalanceSample`.
STARTED, _BEFORE_M, X2_M, FORCE_N, WEB_PER_PA, VELOCITY_M_S = range(6)
_SIZE = 6
_NOT_STARTED, _BEGUN, _FOLLOWS = 0.0, 1.0, 2.0


@compiled
def measured_force_N(p: Vector, torque_Nm: float, x_m: float, v_m_s: float, f_next_N: float) -> float:
    """Web force on roller 2 (N, including `f_next_N`) from a line's parameters, measured torque (N·m), position and
    speed of the roller at the web (m, m/s), and the tension after it (N)."""
    n = int(p[lay.W_AXES])
    axis = lay.W_SIZE + _AXIS * lay.A_SIZE
    motor = lay.W_SIZE + n * lay.A_SIZE + _AXIS * lay.M_SIZE
    ratio = p[motor + lay.M_RAD_PER_M]
    torque = laws.shaft_torque_Nm(p, motor, laws.true_torque_Nm(p, motor, torque_Nm), x_m * ratio)
    direction = measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    resistance = laws.measured_resistance_N(p, axis, x_m, v_m_s, direction)
    return float(laws.passed_on_N(p, axis, ratio * torque, direction) + f_next_N - resistance)


@compiled
def use_modulus(balance: BalanceVectors, youngs_modulus_Pa: float) -> None:
    """Set E for the web's creep and damping."""
    at = modulus_place(balance.web.p)
    if abs(youngs_modulus_Pa / balance.web.p[at] - 1.0) > _WORTH_TELLING:
        balance.web.p[at] = youngs_modulus_Pa


@compiled
def creep_per_N(balance: BalanceVectors) -> float:
    """Creep over the roller after the span, by the model."""
    return float(balance.web.p[modulus_place(balance.web.p) - lay.SP_MODULUS_PA + _CREEP])


@compiled
def momentum_balance(
    balance: BalanceVectors,
    x1_m: float,
    x2_m: float,
    torque_Nm: float,
    strain_prev: float,
    F_next_N: float,
    behind_N: float,
    strain_next: float,
    creep_ratio_prev: float,
    duration_s: float,
) -> None:
    """Compute the balance at this SYNC into the state, `duration_s` after the last; positions at the web, torque at the
    motor.

    `behind_N`, `strain_next`: tension and strain of the web after roller 2; of several rollers as one the tension is
    not `F_next_N`, which is after the last of them. `creep_ratio_prev`: as in `put_boundary`.
    """
    s, velocity_m_s = balance.s, 0.0
    if s[STARTED] == _FOLLOWS:
        follow_to(balance.web, x1_m, x2_m, duration_s)
        velocity_m_s = (x2_m - s[_BEFORE_M]) / duration_s
    put_boundary(balance.web, strain_prev, behind_N, strain_next, creep_ratio_prev)
    s[STARTED] = _FOLLOWS
    s[_BEFORE_M] = x2_m
    s[X2_M] = x2_m
    s[FORCE_N] = measured_force_N(balance.p, torque_Nm, x2_m, velocity_m_s, F_next_N)
    s[WEB_PER_PA] = balance.web.tension[0] / balance.web.p[modulus_place(balance.web.p)]
    s[VELOCITY_M_S] = velocity_m_s


def mass_at_web_kg(p: Vector) -> float:
    """Mass of roller 2 with its motor, at the web, with the model's effects."""
    axis = Layout.of(p).axis_rows(p)[_AXIS]
    inertia = 1.0 + axis[lay.place("inertia_mismatch", "relative_change")]
    return float((axis[lay.A_MOTOR_MASS_KG] + axis[lay.A_ROLLER_MASS_KG]) * inertia)


class MeasuredBalance:
    """Momentum balance of axis 2 of a two-roller model, cycle by cycle; also the encoders' strain.

    The model's `torque_delay` of axis 2 is not compensated here: `hilbench.estimation.web_line.delay` does, with the
    delay it finds. Gear play is neglected. Raises ValueError for a model without a web or with other than two rollers.
    """

    def __init__(self, model: ModelParameters) -> None:
        if model.web is None or model.axis_count != 2:
            raise ValueError(f"a model of {model.axis_count} axes, expected two driven rollers with a web")
        self.web = SpanFollower(model)
        self._p = lay.pack(model)
        axis = Layout.of(self._p).axis_rows(self._p)[_AXIS]
        self.mass_kg = mass_at_web_kg(self._p)
        self.force_per_torque_per_m = model.motor_rad_per_m(2)  #: i/r
        self.section_m2 = model.section_m2(1)
        self.span_length_m = model.span_length_m(1)
        self.dry_friction_N = float(
            axis[lay.place("coulomb_friction", "force_N")] + axis[lay.place("stribeck_friction", "force_N")]
        )
        self.state = np.zeros(_SIZE)

    @property
    def vectors(self) -> BalanceVectors:
        """Vectors of this balance, for compiled callers."""
        return BalanceVectors(self._p, self.web.vectors, self.state)

    @property
    def sample(self) -> BalanceSample:
        """Last sample."""
        return BalanceSample(*self.state[X2_M:].tolist())

    @property
    def is_followed(self) -> bool:
        """True if the web's position is initialized."""
        return self.state.item(STARTED) != _NOT_STARTED

    def reset(self) -> None:
        """Restart at the next update, with the web strained as upstream."""
        self.state[STARTED] = _NOT_STARTED

    def begin(self, x1_m: float, x2_m: float, strain_prev: float) -> None:
        """Place the web at the rollers if it is not yet followed; call it before `momentum_balance`."""
        if self.state[STARTED] == _NOT_STARTED:
            self.web.reset((x1_m, x2_m), strain=[strain_prev])
            self.state[STARTED] = _BEGUN
