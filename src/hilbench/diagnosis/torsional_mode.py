"""What swings at a frequency of its own beside friction: a torsional shaft of a lone axis.

How it swings when a recording begins no recording says, so rows count once that has faded. And in a steady motion
friction that turns over late after each reversal is a torque that is late, as that of a shaft is: how friction turns
over is looked at again beside what swings.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.measured_motion import OnMeasuredMotion
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Term, parts

Array = NDArray[np.float64]

#: Lines of the spectrum by which a resonance has to be told at least.
_LEAST_LINES: Final = 4.0
#: Time constants after which a swing has faded, and the share of a recording that is left out for it at most, behind
#: its beginning and its gaps.
_FADED: Final = 4.0
_MOST_FORGOTTEN: Final = 0.5


def with_torsional_mode(space: Space, terms: list[Term]) -> OnMeasuredMotion | None:
    """The prediction that is right beside those of the terms that swing; None without any, or of a free run."""
    torsional = [term for term in terms if term.swings]
    if not torsional or not isinstance(space.predictor, OnMeasuredMotion):
        return None
    others = [term for term in terms if not term.swings]
    variants = [others]
    for term in torsional:
        here, steps = term.coordinates(), term.steps()
        shapes = range(term.linear, len(here))
        variants += [[*others, term], *([*others, term.at(here + steps * (np.arange(len(here)) == k))] for k in shapes)]
    parameters = np.array([space.packed(variant) for variant in variants])
    most_s = _MOST_FORGOTTEN * space.duration_s / space.predictor.starts
    memory_s = min(max(map(_memory_s, torsional)), most_s)
    return space.predictor.with_torsional_mode(parameters, memory_s)


def untold(space: Space, found: Fit) -> list[Term]:
    """The terms that swing of which the motion has too few frequencies: share, frequency, damping and another inertia
    or friction may make up for each other in each of them."""
    rows, result = space.predictor.rows, []
    derivatives = space.point(found.terms, found.residual).derivatives
    for term, part in zip(found.terms, parts(found.terms), strict=True):
        # Rows are not cut out: the sine that goes on behind a gap with another phase would be another line.
        if term.swings and _lines(np.where(rows, derivatives[part.start], 0.0)) < _LEAST_LINES:
            result.append(term)
    return result


def _lines(values: Array) -> float:
    """Into how many lines of equal size the spectrum of values (signals, n) would be divided: (Σp)² / Σp²."""
    power = np.abs(np.fft.rfft(values, axis=-1)) ** 2
    return float(np.sum(power) ** 2 / np.sum(power**2))


def _memory_s(term: Term) -> float:
    """Decay time of a resonance's free oscillation, s."""
    return _FADED / (2.0 * np.pi * term.values["frequency_Hz"] * term.values["damping"])
