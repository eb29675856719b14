"""What one steady sine of a lone axis can't tell: it passes each place with one speed and one acceleration.

There what grows with the size of the speed goes with the position, as a ripple of an order that a short arc does not
tell does; and what is late, or goes with the load, is friction that turns over a way, or grows with the speed. Of the
laws that are no simpler than these nothing is offered of which they leave little.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.steps import CandidateSet
from hilbench.diagnosis.stretched_problem import basis, without
from hilbench.diagnosis.terms import Term
from hilbench.plant.effect import Domain

Array = NDArray[np.float64]

#: Share of a response that what such a motion can't tell from it has to leave of it.
_OWN_SHARE: Final = 0.25


def is_on_one_sine(space: Space) -> bool:
    """True if a lone axis moves to and fro by one steady sine."""
    return isinstance(space.predictor, OnMeasuredMotion) and space.predictor.sine_Hz is not None


def identifiable_on_one_sine(space: Space, terms: list[Term], offered: CandidateSet) -> list[bool]:
    """True for each candidate that the motion identifies; all of any but one steady sine. A resonance is judged by
    the lines of its spectrum, once it is found (`hilbench.diagnosis.torsional_mode.untold`)."""
    predictor = space.predictor
    if not isinstance(predictor, OnMeasuredMotion) or predictor.sine_Hz is None:
        return [True] * len(offered.candidates)
    moving = map(_is_law_of_motion, offered.candidates)
    laws = [response for response, is_law in zip(offered.responses, moving, strict=True) if is_law]
    alike = np.concatenate([predictor.alike_on_one_sine(space.packed(terms)), offered.own, *laws])
    counted = alike[..., predictor.rows]
    known = basis(counted[np.any(counted, axis=(1, 2))].reshape(-1, counted.shape[1] * counted.shape[2]))
    return [
        term.swings or _is_law_of_motion(term) or _own_share(response[..., predictor.rows], known) >= _OWN_SHARE
        for term, response in zip(offered.candidates, offered.responses, strict=True)
    ]


def _is_law_of_motion(term: Term) -> bool:
    """Friction, offset and inertia: without them no other law is read aright."""
    return not term.effect.removable or (term.effect.domain is Domain.INERTIA and not term.swings)


def _own_share(response: Array, known: Array) -> float:
    """Share of a response (J, signals, n) that a basis (B, signals·n) leaves of it."""
    return float(np.sum(without(response, known) ** 2)) / max(float(np.sum(response**2)), 1e-300)
