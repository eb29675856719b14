"""Candidates as columns of responses, and what a search chooses of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hilbench.arrays import Array
from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.noise import Whitening
from hilbench.diagnosis.residual_analysis import Misfit
from hilbench.diagnosis.terms import Key, Place, Term


@dataclass
class CandidateSet:
    """The candidates at a model, and their raw responses."""

    whitening: Whitening
    residual: Array  #: raw
    own: Array  #: raw columns of the terms that are there
    candidates: list[Term]
    responses: list[Array]  #: raw, (1 or 2, signals, n) each

    def members(self, own: int) -> list[tuple[Term, list[int]]]:
        """Each candidate with its columns, behind so many others."""
        edges = np.cumsum([own, *map(len, self.responses)])
        columns = (list(range(low, high)) for low, high in pairwise(edges))
        return list(zip(self.candidates, columns, strict=True))


@dataclass
class Selection:
    """The chosen terms, fitted; with which others each is tied; the candidates that were there at the end."""

    fit: Fit
    candidates: CandidateSet
    tied: dict[Key, list[Place]] = field(default_factory=dict)
    evidence: dict[Key, dict[str, float]] = field(default_factory=dict)
    exhausted: bool = False  #: more terms would explain more than may be named
    better: Misfit | None = None  #: an explanation outside the vocabulary that is better than a term
    unidentifiable: list[Term] = field(default_factory=list)  #: not distinguishable from others by the motion
    of_too_few: list[Term] = field(default_factory=list)  #: that explain, by too few frequencies to be named
