"""Momentum balance of the roller after the first span, on measured motion and torque.

    m·v2' = (i/r)·τ2 + F_next − R2(v2) − F,   F = E·h          (design section 5)

Everything but E is measured or in the model, effects included, so each cycle has information on E: h = F/E is the web's
section times its strain by the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Annotated, Any, Final, NamedTuple

import numpy as np

from hilbench.compiled import Reals, Record, Vector, compiled, inlined, record_type
from hilbench.plant.motor_laws import measured_direction
from hilbench.plant.web_line import kernel, laws, line_kernel, motion, records, splice_laws
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.line_vectors import LineVectors, arrays
from hilbench.plant.web_line.parameters import ModelParameters

_AXIS = 1  #: index of axis 2
#: Of the measured web, a line of two driven rollers: offsets of their speeds in the state (`roller_speed_m_s`) and of
#: the unstretched web between them; columns of its tension and strain in the outputs.
_SPEED, _UNSTRETCHED = lay.S_Y + 2, lay.S_Y + 8
_TENSION, STRAIN = 6, 7
#: Relative change of E that is passed to the follower: its creep and damping depend on it.
_WORTH_TELLING = 1e-4


@dataclass(slots=True)
class BalanceSample:
    """One instant of the balance; forces at the web."""

    x2_m: float  #: measured position of roller 2; of several rollers as one, of their centre of mass
    force_N: float  #: (i/r)·τ2 + F_next − R2(v2), with the model's effects
    web_per_Pa: float  #: ∂F/∂E in N/Pa: section times strain; 0 while the web is slack
    velocity_m_s: float  #: of roller 2, from two positions


#: State of a balance: phase (_BEGUN: the web was placed in this cycle) and previous position; creep ratio at roller 1,
#: and tension after roller 2; then the fields of a `BalanceSample`.
BALANCE: Final = record_type(
    *("started", "before_m", "creep_ratio_prev", "F_next_N", "x2_m", "force_N", "web_per_Pa", "velocity_m_s")
)
NOT_STARTED, _BEGUN, _FOLLOWS = 0.0, 1.0, 2.0


class BalanceVectors(NamedTuple):
    """Arrays of a `MeasuredBalance`, for compiled callers."""

    p: Reals  #: parameters of the two rollers
    web: LineVectors  #: held to the measured motion
    s: Annotated[Any, BALANCE]


@compiled
def measured_force_N(p: Vector, torque_Nm: float, x_m: float, v_m_s: float, f_next_N: float) -> float:
    """Web force on roller 2 (N, including `f_next_N`) from a line's parameters, measured torque (N·m), position and
    speed of the roller at the web (m, m/s), and the tension after it (N)."""
    line, direction = records.of_parameters(p), measured_direction(v_m_s, laws.FRICTION_WIDTH_M_S)
    axis, motor = records.axis(line, _AXIS), records.motor(line, _AXIS)
    torque = laws.shaft_torque_Nm(motor, laws.true_torque_Nm(motor, torque_Nm), x_m * motor.rad_per_m)
    resistance = laws.measured_resistance_N(axis, x_m, v_m_s, direction)
    return float(laws.passed_on_N(axis, motor.rad_per_m * torque, direction) + f_next_N - resistance)


@inlined
def _span(balance: BalanceVectors) -> Record:
    """`SPAN` of the web between the rollers."""
    return records.span(arrays(balance.web), 0)


@inlined
def tension_N(balance: BalanceVectors) -> float:
    """Tension of the web between the rollers."""
    return float(balance.web.out[_TENSION])


@inlined
def strain(balance: BalanceVectors) -> float:
    """Strain of the web between the rollers."""
    return float(balance.web.out[STRAIN])


@inlined
def roller_speed_m_s(balance: BalanceVectors, roller: int) -> float:
    """Speed of a roller, from 0, over the last cycle."""
    return float(balance.web.s[_SPEED + roller])


@compiled
def spliced(balance: BalanceVectors) -> tuple[bool, float, float]:
    """True if there are pieces of other web; their effect on the span (`SplicedSpan`)."""
    line = arrays(balance.web)
    pieces = records.pieces(line)
    if not pieces.count > 0.0:
        return False, 1.0, 1.0
    stretch = 1.0 + motion.strain_prev(line, kernel.time_s(line))
    travel_m, unstretched_m = line.s[lay.S_Y], line.s[_UNSTRETCHED]
    factor = splice_laws.series_factor(pieces, travel_m, 0.0, unstretched_m, stretch)
    at_end = 1.0 + splice_laws.change_at(pieces, travel_m, unstretched_m, stretch, lay.LEAST_BLUR_M)
    return True, factor, at_end


@compiled
def _follow_to(balance: BalanceVectors, x1_m: float, x2_m: float, duration_s: float) -> None:
    """Move the two rollers with web between to these positions, `duration_s` after the last call.

    In reverse the web leaves over roller 1 at the creep ratio there.
    """
    line, s = arrays(balance.web), balance.web.s
    v1_m_s, v2_m_s = (x1_m - s[lay.S_Y]) / duration_s, (x2_m - s[lay.S_Y + 1]) / duration_s
    leaving = 1.0 + balance.s.creep_ratio_prev if v1_m_s < 0.0 else 1.0
    line_kernel.set_speed(line, 0, v1_m_s * leaving)
    line_kernel.set_speed(line, 1, v2_m_s)
    line_kernel.roll_on(line, duration_s, records.web(line).sample_time_s, inf)
    kernel.observe(*balance.web)
    line_kernel.set_speed(line, 0, v1_m_s)
    line_kernel.set_position(line, 0, x1_m)  # exactly: no drift from adding up
    line_kernel.set_position(line, 1, x2_m)


@compiled
def use_modulus(balance: BalanceVectors, youngs_modulus_Pa: float) -> None:
    """Set E for the web's creep and damping."""
    span = _span(balance)
    if abs(youngs_modulus_Pa / span.modulus_Pa - 1.0) > _WORTH_TELLING:
        span.modulus_Pa = youngs_modulus_Pa


@compiled
def creep_per_N(balance: BalanceVectors) -> float:
    """Creep over the roller after the span, by the model."""
    return float(_span(balance).web_slip.creep_per_N)


@compiled
def momentum_balance(
    balance: BalanceVectors, x1_m: float, x2_m: float, torque_Nm: float, around: tuple[float, ...], duration_s: float
) -> None:
    """Compute the balance at this SYNC into the state, `duration_s` after the last; positions at the web, torque at the
    motor.

    `around`: inlet strain; tension after the line; tension and strain of the web after roller 2; creep ratio at roller
    1: share by which the web before the line pulls the web back over the first roller. What enters has that in its
    strain; in reverse so much more leaves than the roller turns.
    """
    line = arrays(balance.web)
    outside = records.boundary(line)
    strain_prev, F_next_N, behind_N, strain_next, creep_ratio_prev = around
    s, velocity_m_s = balance.s, 0.0
    if s.started == _FOLLOWS:
        _follow_to(balance, x1_m, x2_m, duration_s)
        velocity_m_s = (x2_m - s.before_m) / duration_s
    s.creep_ratio_prev = creep_ratio_prev
    changed = outside.strain_prev != strain_prev or s.F_next_N != behind_N
    outside.strain_prev, s.F_next_N = strain_prev, behind_N
    # Strain of the web after roller 2 is its tension over its stiffness; without tension any force without effect does.
    outside.F_next_N = behind_N if behind_N != 0.0 else strain_next
    records.web(line).downstream_stiffness_N = behind_N / strain_next if behind_N != 0.0 else 1.0
    if changed:
        kernel.observe(*balance.web)
    s.started = _FOLLOWS
    s.before_m = x2_m
    s.x2_m = x2_m
    s.force_N = measured_force_N(balance.p, torque_Nm, x2_m, velocity_m_s, F_next_N)
    s.web_per_Pa = tension_N(balance) / _span(balance).modulus_Pa
    s.velocity_m_s = velocity_m_s


def mass_at_web_kg(p: Vector) -> float:
    """Mass of roller 2 with its motor, at the web, with the model's effects."""
    axis = Layout.of(p).axis_rows(p)[_AXIS]
    return float((axis.motor_mass_kg + axis.roller_mass_kg) * (1.0 + axis.inertia_mismatch.relative_change))


class MeasuredBalance:
    """Momentum balance of axis 2 of a two-roller model, cycle by cycle; also the encoders' strain.

    The model's `torque_delay` of axis 2 is not compensated here: `hilbench.estimation.web_line.delay` does, with the
    delay it finds. Gear play is neglected. Raises ValueError for a model without a web or with other than two rollers.
    """

    def __init__(self, model: ModelParameters) -> None:
        if model.web is None or model.axis_count != 2:
            raise ValueError(f"a model of {model.axis_count} axes, expected two driven rollers with a web")
        self.web = LineFollower(model)
        self._p = lay.pack(model)
        axis = Layout.of(self._p).axis_rows(self._p)[_AXIS]
        self.mass_kg = mass_at_web_kg(self._p)
        self.force_per_torque_per_m = model.motor_rad_per_m(2)  #: i/r
        self.section_m2 = model.section_m2(1)
        self.span_length_m = model.span_length_m(1)
        self.dry_friction_N = float(axis.coulomb_friction.force_N + axis.stribeck_friction.force_N)
        self._arrays = np.zeros(1, BALANCE)
        self.state = self._arrays[0]

    @property
    def vectors(self) -> BalanceVectors:
        """Vectors of this balance, for compiled callers."""
        return BalanceVectors(self._p, self.web.vectors, self._arrays)

    @property
    def sample(self) -> BalanceSample:
        """Last sample."""
        return BalanceSample(*self.state.item()[-4:])

    def reset(self) -> None:
        """Restart at the next update, with the web strained as upstream."""
        self.state["started"] = NOT_STARTED

    def begin(self, x1_m: float, x2_m: float, strain_prev: float) -> None:
        """Place the web at the rollers if it is not yet followed; call it before `momentum_balance`."""
        if self.state["started"] == NOT_STARTED:
            self.web.reset((x1_m, x2_m), strain=[strain_prev])
            self.state["started"] = _BEGUN
