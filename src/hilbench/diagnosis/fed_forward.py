"""What a feed-forward adds to a torque that is recorded before it, where the inertia shows that there is one.

It goes with the commanded motion: the torque lacks the inertia of that, and has it of what the axis oscillates about
it. And it may add more friction than there is: then the axis has less than none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.diagnosis import machines
from hilbench.diagnosis.data_cleaning import Repair
from hilbench.diagnosis.fit import fitted, uncertainty_of
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.measured_rules import CHANCE, LEAST_SHARE, least_share
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.smooth_motion import low_passed
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import basis, without
from hilbench.diagnosis.terms import strength_parts

#: Share of the model's inertia from which the torque lacks it because it is fed forward: no rotor is half as heavy.
_FED_FORWARD: Final = -0.5
#: Highest frequencies of a commanded motion that are tried, Hz, and where nothing of it is left, in these.
_COMMANDED_HZ, _BEYOND = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0), 2.5


def without_oscillation(space: Space, proposer: Proposer, selection: Selection, data: Measured) -> Measured | None:
    """The measurement whose torque lacks the inertia that is fed forward at all frequencies; None where that leaves no
    less."""
    predictor, lacking = space.predictor, _lacking(selection)
    if not isinstance(predictor, OnMeasuredMotion) or lacking > _FED_FORWARD:
        return None
    # A delay makes up for such an oscillation.
    found = fitted(space, [term for term in selection.fit.terms if term.probe is None])
    rows, acceleration = predictor.rows, predictor.acceleration
    inertia = -lacking * machines.Nm_per_acceleration(space.model, 1)
    fast_Nm = [
        inertia * (acceleration - low_passed(acceleration, data.period_s, (high, _BEYOND * high)))
        for high in _COMMANDED_HZ
    ]
    own = space.point(found.terms, found.residual).derivatives[..., rows]
    columns = np.array([found.residual[:, rows], *(predictor.compared(each)[None, rows] for each in fast_Nm)])
    rest, *responses = without(columns, basis(own.reshape(len(own), -1)))
    left = [float(np.sum((rest - each) ** 2)) for each in responses]
    best = int(np.argmin(left))
    if left[best] > (1.0 - LEAST_SHARE) * float(np.sum(rest**2)):
        return None
    high = _COMMANDED_HZ[best]
    text = f"inertia is fed forward with commands up to {high:g} Hz: that of faster motion is taken out as well"
    return _with_torque(data, -fast_Nm[best], text)


def without_excess(space: Space, proposer: Proposer, selection: Selection, data: Measured) -> Measured | None:
    """The measurement with the dry friction that is fed forward beyond what there is taken back; None where there is
    none that is certain."""
    found, predictor = selection.fit, space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or _lacking(selection) > _FED_FORWARD:
        return None
    free = (term for term in proposer.direct() if not any(map(term.overlaps, found.terms)))
    if (dry := next((term for term in free if term.effect.id == "coulomb_friction"), None)) is None:
        return None
    of_any_sign = tuple(replace(each, lower=-each.upper) for each in dry.effect.parameters)
    friction = replace(dry, effect=replace(dry.effect, parameters=of_any_sign))
    beside = fitted(space, [*found.terms, friction])
    moved, rows = beside.terms[-1].moved, predictor.rows
    chance = uncertainty_of(space, beside).chance(strength_parts(beside.terms)[-1], moved)
    before, left = (float(np.sum(each.residual[:, rows] ** 2)) for each in (found, beside))
    if moved[0] > 0.0 or chance > CHANCE or left > (1.0 - least_share(friction)) * before:
        return None
    torque_Nm = -float(moved[0]) / space.model.motor_rad_per_unit(1)
    text = f"{torque_Nm:.3g} N·m more dry friction is fed forward than there is, and taken back"
    return _with_torque(data, torque_Nm * predictor.direction, text)


def _lacking(selection: Selection) -> float:
    """Relative change of the inertia in the torque that was found; 0 without."""
    signs = {("inertia_mismatch", None): 1.0, ("feed_forward", "inertia_share"): -1.0}
    return sum(
        signs[term.effect.id, term.part] * float(term.moved[0])
        for term in selection.fit.terms
        if (term.effect.id, term.part) in signs
    )


def _with_torque(data: Measured, torque_Nm: np.ndarray, text: str) -> Measured:
    repair = Repair("feed_forward", "tau1_Nm", len(data.t_s), text)
    return replace(data, tau_Nm={1: data.tau_Nm[1] + torque_Nm}, repairs=[*data.repairs, repair])
