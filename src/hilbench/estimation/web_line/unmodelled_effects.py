"""Unmodelled effects of a driven roller, estimated in addition to E from its momentum balance.

The method of a span gets the force less the accepted effects. Until the evidence for an effect is overwhelming only
commissioned values are compensated, and E is the model's view of the torque; the stated deviation of E includes that of
all effects together.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot, inf, sqrt
from typing import Final

import numpy as np

from hilbench.arrays import Array
from hilbench.compiled import VECTOR, entry_point, viewed
from hilbench.estimation.assumptions import POSITION_FLOOR_M, POSITION_NOISE_M, SEPARABLE, TORQUE_FLOOR_NM
from hilbench.estimation.noise_level import NoiseLevel
from hilbench.estimation.nuisance import Nuisance
from hilbench.estimation.web_line import unmodelled_filter as filters
from hilbench.estimation.web_line.balance import MeasuredBalance
from hilbench.estimation.web_line.block_means import BLOCK_S
from hilbench.estimation.web_line.config import ModelErrorsConfig, Prior
from hilbench.estimation.web_line.unmodelled_filter import FILTER
from hilbench.plant.parameters import per_item
from hilbench.plant.web_line.laws import FRICTION_WIDTH_M_S
from hilbench.plant.web_line.parameters import ModelParameters

#: Prior deviation of E: any force in phase with the strain counts as E until the data separate them.
_INITIAL_E: Final = 0.5
#: Random walk of E without measurements, relative per √s.
_HOLD_WALK: Final = 0.02
#: Force that keeps a roller at rest, and friction at the onset, over the dry friction of a turning one: anything
#: between both signs.
_STUCK: Final = 0.6
#: By how many usual deviations a dry friction may come out below none: as much as a small offset taken for it.
_LESS_FRICTION: Final = 0.3
#: Factor on the deviation of accelerating mass: the errors of a ramp's blocks are alike.
_ALIKE_IN_A_RAMP: Final = 1.5
#: Noise of the torque until it is measured: the method's default, N·m.
_TORQUE_NOISE_NM: Final = 0.05
#: States by the name of the reported quantity, and of a prior.
_STATES: Final = {
    "torque_offset_Nm": filters.OFFSET,
    "dry_friction_N": filters.DRY,
    "viscous_friction_N_s_per_m": filters.VISCOUS,
    "torque_scale": filters.SCALE,
    "inertia_share": filters.MASS,
    "creep_per_N": filters.CREEP,
}
_NAMED: Final = ("torque_offset_Nm", "dry_friction_N", "viscous_friction_N_s_per_m", "creep_per_N")
_FORCES: Final = ("torque_offset_Nm", "dry_friction_N", "viscous_friction_N_s_per_m")
_TURNING: Final = (filters.UNBALANCE_COS, filters.UNBALANCE_SIN, filters.COS2, filters.SIN2, filters.COS1, filters.SIN1)
#: Random walks, as a share of the prior deviation, and their time (s), of these states: an offset with that of a drive
#: over a shift, friction with the temperature of bearings and seals, the rest with the model's simplifications.
_WALKS: Final = {
    (0.15, 28800.0): (filters.OFFSET,),
    (0.15, 1200.0): (filters.DRY, filters.STRIBECK, filters.VISCOUS),
    (0.1, 3600.0): (filters.SCALE, filters.MASS, filters.CREEP, *_TURNING),
}


def prior_deviations(config: ModelErrorsConfig, model: ModelParameters, force_per_torque_per_m: float) -> Array:
    """Prior standard deviations of the states (STATES,), from the machine's sizes; 0 for E and the disturbance."""
    boundary, f = model.boundary, filters
    tension_N = max(boundary.upstream_tension_N, boundary.downstream_tension_N)
    strain = tension_N / model.stiffness_N(1)
    if model.drives is not None:
        limit_Nm = per_item(model.drives.torque_limit_Nm, 2)
    else:
        limit_Nm = 5.0 * tension_N / force_per_torque_per_m
    friction_N = 0.01 * config.friction_pct * tension_N
    priors = np.zeros(f.STATES)
    priors[f.OFFSET] = hypot(
        0.01 * config.torque_offset_pct * limit_Nm * force_per_torque_per_m, 0.01 * config.strain_pct * tension_N
    )
    priors[f.DRY] = friction_N
    priors[f.STRIBECK] = priors[f.STUCK] = _STUCK * friction_N
    priors[f.VISCOUS] = friction_N / config.at_speed_m_s
    priors[f.SCALE] = 0.01 * config.torque_scale_pct
    priors[f.MASS] = 0.01 * config.inertia_pct
    priors[f.UNBALANCE_COS] = priors[f.UNBALANCE_SIN] = 0.01 * config.unbalance_pct * tension_N
    priors[f.CREEP] = 0.01 * config.creep_pct * strain / tension_N
    for axis, cosine in ((2, f.COS2), (1, f.COS1)):
        priors[cosine] = priors[cosine + 1] = 1e-6 * config.eccentricity_um / model.radius_m(axis) / sqrt(2.0)
    return priors


def priors_behind(priors: Sequence[Prior], span: int, model: ModelParameters) -> list[Prior]:
    """Priors of the rollers after a span (from 1) of a line, combined to those of axis 2 of two rollers.

    Forces of several rollers add up if each of them is known; a share of mass or torque is that of one roller.
    """
    axes = range(span + 1, model.axis_count + 1)
    per_m = model.motor_rad_per_m(span + 1)
    found = []
    for quantity in _STATES:
        of_each = [prior for prior in priors if prior.quantity == quantity and prior.axis in axes]
        if len(of_each) != len(axes) or (len(axes) > 1 and quantity not in _FORCES):
            continue
        units = [
            model.motor_rad_per_m(prior.axis) / per_m if quantity == "torque_offset_Nm" else 1.0 for prior in of_each
        ]
        value = sum(unit * prior.value for unit, prior in zip(units, of_each, strict=True))
        deviation = hypot(*(unit * prior.deviation for unit, prior in zip(units, of_each, strict=True)))
        found.append(of_each[0].model_copy(update={"axis": 2, "value": value, "deviation": deviation}))
    return found


@entry_point(VECTOR)
def _interrupt(state: Array) -> None:
    filters.interrupt(viewed(state, FILTER)[0])


class UnmodelledEffects:
    """Estimator of friction, offset, scale, mass, creep, unbalance and eccentricity beyond the model's, for the roller
    after the first span. `priors`: commissioned values of its axis."""

    def __init__(
        self,
        config: ModelErrorsConfig,
        model: ModelParameters,
        balance: MeasuredBalance,
        youngs_modulus_Pa: float,
        cycle_s: float,
        priors: Sequence[Prior] = (),
    ) -> None:
        self.state = np.zeros(1, FILTER)  #: for compiled callers
        f, s = filters, self.state[0]
        s["force_per_torque_per_m"] = balance.force_per_torque_per_m
        deviations = prior_deviations(config, model, balance.force_per_torque_per_m)
        self._radius_m = model.radius_m(2)
        s["mass_kg"], s["span_m"] = balance.mass_kg, balance.span_length_m
        s["reference_Pa"], s["stiffness_N"] = youngs_modulus_Pa, youngs_modulus_Pa * balance.section_m2
        s["radius_1_m"], s["radius_2_m"] = model.radius_m(1), model.radius_m(2)
        s["tension_N"] = max(model.boundary.upstream_tension_N, model.boundary.downstream_tension_N)
        s["standstill_m_s"] = 5.0 * FRICTION_WIDTH_M_S
        for walk, states in _WALKS.items():
            s["wander"][list(states)], s["wander_s"][list(states)] = walk[0] ** 2, walk[1]
        for prior in priors:
            at = _STATES[prior.quantity]
            unit = balance.force_per_torque_per_m if at == f.OFFSET else 1.0
            # A motor with more force per torque than assumed needs less torque.
            sign = -1.0 if at == f.SCALE else 1.0
            s["base"][at], deviations[at] = sign * unit * prior.value, unit * prior.deviation
        less = 1.0 + s["stiffness_N"] * s["base"][f.CREEP]  # the state κ' is less than κ, see the filter
        s["base"][f.CREEP] /= less
        deviations[f.CREEP] /= less**2
        s["prior"] = deviations**2
        s["theta"] = s["base"]
        s["torque_noise"] = NoiseLevel(_TORQUE_NOISE_NM, TORQUE_FLOOR_NM).state
        s["position_noise"] = NoiseLevel(POSITION_NOISE_M, POSITION_FLOOR_M).state
        s["unrest_N2"] = f.least_unrest_N2(s["tension_N"])
        s["x"][f.E] = s["modulus"] = 1.0
        s["covariance"] = np.diag(s["prior"])
        s["covariance"][f.E, f.E], s["covariance"][f.DISTURBANCE, f.DISTURBANCE] = _INITIAL_E**2, s["unrest_N2"]
        s["spread_N"] = hypot(deviations[f.OFFSET], deviations[f.DRY])
        evidence, prior = s["evidence"], s["prior"]
        members = [(at, number) for number, group in enumerate(filters.GROUPS) for at in group if prior[at] > 0.0]
        evidence["count"] = len(members)
        evidence["least"] = -inf
        for place, (at, number) in enumerate(members):
            evidence["places"][place], evidence["groups"][place] = at, number
            if at == f.DRY:  # no friction pushes
                least_N = balance.dry_friction_N + s["base"][at]
                evidence["least"][place] = -least_N / sqrt(prior[at]) - _LESS_FRICTION
        self._set_cycle(cycle_s)

    def _set_cycle(self, cycle_s: float) -> None:
        self.state[0]["cycle_s"], self.state[0]["block"] = cycle_s, max(2, round(BLOCK_S / cycle_s))

    def interrupt(self) -> None:
        """Discard the current block: a cycle is missing or unusable."""
        _interrupt(self.state.view(np.float64))

    def set_cycle_time(self, cycle_s: float) -> None:
        """Set the cycle time; estimates are kept."""
        self._set_cycle(cycle_s)
        self.interrupt()

    def hold(self, duration_s: float) -> None:
        """Skip a time without measurement: the variance of E grows, unmodelled effects stay."""
        self.interrupt()
        self.state[0]["covariance"][filters.E, filters.E] += _HOLD_WALK**2 * duration_s

    def release(self) -> None:
        """Widen E after a change of the web."""
        self.interrupt()
        self.state[0]["covariance"][filters.E, filters.E] += _INITIAL_E**2

    def know(self, modulus_Pa: float, deviation_Pa: float, friction_N: float, friction_deviation_N: float) -> None:
        """Set E, and dry friction beyond the model's, from another source."""
        s = self.state[0]
        reference_Pa = s["reference_Pa"]
        for at, value, deviation in (
            (filters.E, modulus_Pa / reference_Pa, deviation_Pa / reference_Pa),
            (filters.DRY, friction_N - s["base"][filters.DRY], friction_deviation_N),
        ):
            s["x"][at] = value
            s["covariance"][at, :] = s["covariance"][:, at] = 0.0
            s["covariance"][at, at] = deviation**2

    def found(self) -> tuple[Nuisance, ...]:
        """Nuisance parameters estimated beyond the model; of the eccentricity (of roller 2) the amplitude. The mass is
        the one that the measured torque accelerates: its error and that of the torque's scale are not separable, and
        stated as one."""
        s = self.state[0]
        mean, deviations = s["base"] + s["x"], np.sqrt(np.diag(s["covariance"]))
        priors = np.sqrt(s["prior"])
        rows = []
        for name in _NAMED:
            at = _STATES[name]
            deviation = deviations.item(at)
            unit = unit_of_deviation = float(s["force_per_torque_per_m"]) if at == filters.OFFSET else 1.0
            if at == filters.CREEP:
                unit = 1.0 - float(s["modulus"] * s["stiffness_N"]) * mean.item(at)
                unit_of_deviation = unit**2
            identified = deviation < SEPARABLE * priors.item(at)
            rows.append(Nuisance(name, mean.item(at) / unit, deviation / unit_of_deviation, identified))
        both = [filters.SCALE, filters.MASS]
        deviation = _ALIKE_IN_A_RAMP * sqrt(s["covariance"][np.ix_(both, both)].sum())
        identified = deviation < SEPARABLE * priors.item(filters.MASS)
        rows.append(Nuisance("inertia_share", float(mean[both].sum()), deviation, identified))
        turning = slice(filters.COS2, filters.COS2 + 2)
        deviation = float(np.hypot(*deviations[turning]))
        identified = deviation < SEPARABLE * float(np.hypot(*priors[turning]))
        amplitude_m, deviation_m = float(np.hypot(*mean[turning])) * self._radius_m, deviation * self._radius_m
        rows.append(Nuisance("eccentricity_m", amplitude_m, deviation_m, identified))
        return tuple(rows)
