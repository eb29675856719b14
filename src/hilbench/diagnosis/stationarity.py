"""Stationarity test: is a found effect the same in other frequency bands and other stretches of a recording? An
effect has one size. A substitute for something else has another wherever that is another."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from hilbench.diagnosis.fit import Fit, fit
from hilbench.diagnosis.fit_with_residual_noise import fitted, uncertainty_of, weights
from hilbench.diagnosis.residual_noise import Uncertainty
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.stretched_problem import STRETCHES
from hilbench.diagnosis.terms import parts
from hilbench.plant.effect import Domain

#: Standard deviations by which what a narrower band finds may differ.
_APART: Final = 3.5
#: Share of a strength by which two bands or stretches may differ however sure they are: a filter rounds what turns.
_SAME_SIZE: Final = 0.03


def in_every_band(space: Space, current: Fit) -> Fit:
    """The fit without the terms of which a narrower band finds another size, one by one, what explains least first:
    beside one that stands for something else the others have another size as well.

    An effect has one size; what stands for something else (a delay for a loop's answer to a ripple) changes with
    the frequencies that are looked at. A wave shows in a narrower band at lower speeds only, a resonance below its
    frequency hardly: neither is judged.
    """
    if space.predictor.narrower is None:
        return current
    narrower = replace(space, predictor=space.predictor.narrower)
    while current.terms:
        narrow = fitted(narrower, current.terms)
        apart = _apart(current, narrow, uncertainty_of(space, current), uncertainty_of(narrower, narrow))
        others = [
            fitted(space, [*current.terms[:k], *current.terms[k + 1 :]])
            for k, size in enumerate(apart)
            if size >= _APART
        ]
        if not others:
            break
        current = min(others, key=lambda found: float(np.sum(found.residual[:, space.predictor.rows] ** 2)))
    return current


def in_both_halves(space: Space, current: Fit) -> Fit:
    """The fit without the delays that every other stretch finds in another size than those between.

    A cable is as long in every stretch; what a delay stands for (an arm that swings along) is another from motion
    to motion. Of what the model is linear in each stretch was predicted from the others before.
    """
    rows = space.predictor.rows
    stretches = np.array_split(np.flatnonzero(rows), STRETCHES)
    halves = []
    for first in (0, 1):
        half = np.zeros(len(rows), bool)
        half[np.concatenate(stretches[first::2])] = True
        halves.append(half)
    while any(term.probe is not None for term in current.terms):
        early, late = (fit(space, weights(space, current.terms), current.terms, half) for half in halves)
        sure = [uncertainty_of(space, found, half) for found, half in zip((early, late), halves, strict=True)]
        apart = _apart(early, late, *sure)
        delays = [size if term.probe is not None else 0.0 for size, term in zip(apart, current.terms, strict=True)]
        worst = int(np.argmax(delays))
        if delays[worst] < _APART:
            break
        current = fitted(space, [*current.terms[:worst], *current.terms[worst + 1 :]])
    return current


def _apart(one: Fit, other: Fit, sure: Uncertainty, other_sure: Uncertainty) -> list[float]:
    """By how many standard deviations two fits of the same terms differ in the strength of each, beyond a share of it
    that makes no other effect of it; 0 of a wave, or what swings at a frequency of its own."""
    deviations = np.maximum(np.hypot(sure.deviations, other_sure.deviations), 1e-300)
    found = []
    for a, b, part in zip(one.terms, other.terms, parts(one.terms), strict=True):
        here, there, neutral = (float(term.coordinates()[0]) for term in (a, b, a.neutral()))
        # What a filter rounds of an inertia is a share of all of it, not of what it differs by.
        whole = 1.0 + here if a.effect.domain is Domain.INERTIA else here - neutral
        beyond = abs(here - there) - _SAME_SIZE * abs(whole)
        found.append(0.0 if a.is_of_a_frequency else max(beyond, 0.0) / float(deviations[part.start]))
    return found
