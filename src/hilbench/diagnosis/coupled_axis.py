"""Diagnosis of a lone axis coupled with another one: which effects are identifiable there, and the coupling."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.diagnosis import machines
from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.measured import Measured
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.predictor import Predictor
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.residual_noise import uncertainty
from hilbench.diagnosis.space import Space
from hilbench.plant.effect import Effect
from hilbench.plant.model_file import Machine

#: Effects that change all of a torque, and so what the other axis makes of it, which is not known beforehand; an
#: inertia, to which what is carried adds; and a torsional mode, which an arm has by itself.
_UNIDENTIFIABLE: Final = frozenset({"torque_scale", "torque_delay", "feed_forward", "inertia_mismatch", "resonance"})
#: The experiment that identifies them.
OTHER_HELD: Final = "the same motion while the other axis is held"


def unidentifiable_beside(predictor: Predictor, model: Machine) -> tuple[Effect, ...]:
    """Effects that are not identifiable with another axis coupled; none where there is no other."""
    if predictor.arm is None:
        return ()
    return tuple(effect for effect in machines.vocabulary(model) if effect.id in _UNIDENTIFIABLE)


def proposer_for(predictor: Predictor, model: Machine, data: Measured, without: Collection[str] = ()) -> Proposer:
    """Proposer of effects that are identifiable by a prediction; without: effects that are not looked for.

    With another axis coupled, gravity is looked for in any arc: else it is taken for one of the torques that go with
    both.
    """
    unidentifiable = unidentifiable_beside(predictor, model)
    vocabulary = tuple(
        effect for effect in machines.vocabulary(model) if effect not in unidentifiable and effect.id not in without
    )
    return Proposer(model, data, vocabulary, any_arc=predictor.arm is not None)


def couplings(
    space: Space, predictor: OnMeasuredMotion, found: Fit
) -> dict[str, tuple[float, tuple[float, float], str]]:
    """Torques of another axis at the joint, by name: value, 95 % interval and unit, fitted with the terms that were
    found."""
    alone = replace(space, predictor=predictor.uncoupled)
    beside = alone.point(found.terms, alone.residual(found.terms)).derivatives
    wide = np.concatenate([predictor.couplings[:, None], beside])[..., predictor.rows]
    known = uncertainty(wide, found.residual[..., predictor.rows])
    half = known.deviations * known.quantiles(0.95)
    strengths = predictor.coupled_by(space.packed(found.terms))
    return {
        name: (value, (value - error, value + error), "N·m" if name.endswith("_Nm") else "kg·m²")
        for (name, value), error in zip(strengths.items(), half.tolist(), strict=False)
    }
