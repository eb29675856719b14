"""Which terms the data ask for: one stepwise search, forward and backward.

Every candidate is a column of responses beside those of the terms that are there. Terms are added while that pays, what
the others have made superfluous goes, and at the end each must show that the data are explained worse without it, and
that no other explains them as well: equal ones are tied with it.

What an addition costs, what has to confirm it and what ties two explanations are the rules of a kind of prediction:
those of `steps` where a right model leaves noise alone, those of `select_measured` where it does not.

How often that is right: tools/diagnose_scoreboard.py, tools/diagnose_rigs.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.noise import Whitening
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Key, Place, Term

Array = NDArray[np.float64]
Announce = Callable[[str, float], None]


@dataclass
class CandidateSet:
    """The candidates at a model, and their raw responses."""

    whitening: Whitening
    residual: Array  #: raw
    own: Array  #: raw columns of the terms that are there
    candidates: list[Term]
    responses: list[Array]  #: raw, (1 or 2, signals, n) each

    def groups(self, own: int) -> list[list[int]]:
        """Columns of each candidate, behind so many others."""
        edges = np.cumsum([own, *map(len, self.responses)])
        return [list(range(low, high)) for low, high in pairwise(edges)]


@dataclass(frozen=True)
class Better:
    """An explanation outside the vocabulary that is better than a term."""

    name: str
    detail: str  #: size and time, for a person


@dataclass
class Selection:
    """The chosen terms, fitted; with which others each is tied; the candidates that were there at the end."""

    fit: Fit
    candidates: CandidateSet
    samples: float
    tied: dict[Key, list[Place]] = field(default_factory=dict)
    evidence: dict[Key, dict[str, float]] = field(default_factory=dict)
    exhausted: bool = False  #: more terms would explain more than may be named
    better: Better | None = None
    untold: list[Term] = field(default_factory=list)  #: candidates that the motion can't tell from others
    of_too_few: list[Term] = field(default_factory=list)  #: that explain, by too few frequencies to be named


class Search(ABC):
    """Stepwise search over one space; a subclass has its rules."""

    most_terms: ClassVar[int]

    def __init__(self, space: Space, proposer: Proposer, announce: Announce = lambda text, share: None) -> None:
        self.space, self.proposer, self._announce = space, proposer, announce

    def run(self) -> Selection:
        """Add terms while that pays, then judge what is there."""
        current = self.fit_of([])
        offered = self.candidates(current)
        for depth in range(self.most_terms):
            share = 0.1 + 0.7 * depth / self.most_terms
            self._announce(f"step {depth + 1}: {len(offered.candidates)} candidates", share)
            best = self.best_addition(current, offered)
            if best is None:
                break
            if len(best.terms) > self.most_terms:
                return Selection(current, offered, self.samples, exhausted=True)
            current, offered, promising = self.continued(best, offered)
            if not promising:
                break
        self._announce("what else could explain it", 0.85)
        return self.judged(current, offered)

    @property
    @abstractmethod
    def rows(self) -> NDArray[np.bool_]:
        """(n,): those that count."""

    @property
    @abstractmethod
    def samples(self) -> float:
        """Number of values that fits see."""

    @abstractmethod
    def fit_of(self, terms: list[Term]) -> Fit:
        """A model to begin from."""

    @abstractmethod
    def candidates(self, current: Fit) -> CandidateSet:
        """Every candidate at a model, each with its response."""

    @abstractmethod
    def best_addition(self, current: Fit, offered: CandidateSet) -> Fit | None:
        """The best fit with more terms, without those that they have made superfluous; None where none pays."""

    @abstractmethod
    def continued(self, best: Fit, offered: CandidateSet) -> tuple[Fit, CandidateSet, bool]:
        """What the next step begins from, and whether there may be anything more to explain."""

    @abstractmethod
    def judged(self, current: Fit, offered: CandidateSet) -> Selection:
        """The terms that stay, each with its evidence and what is tied with it."""

    def masked(self, values: Array) -> Array:
        """Values (…, n) with zeros in the rows that do not count."""
        return np.where(self.rows, values, 0.0)
