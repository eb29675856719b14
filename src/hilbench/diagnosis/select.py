"""Which terms the data ask for where a right model leaves noise alone.

Stepwise, earlier choices tested again, judged on stretches that no fit has seen.

Terms are added while that pays (`steps`). Then each must show that the model is worse without it, and that no other
explains the same as well (`alternatives`).

How often that is right: tools/diagnose_scoreboard.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from hilbench.diagnosis.alternatives import Alternatives, Better
from hilbench.diagnosis.fit import Fit
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.steps import CandidateSet, Steps
from hilbench.diagnosis.terms import Key, Place, Term

Announce = Callable[[str, float], None]

#: Most effects that are named: three that leave more than noise are none of them right, and many small ones together
#: are a series expansion of something else.
_MOST_TERMS: Final = 3


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


def search(space: Space, proposer: Proposer, announce: Announce, every: int = 1) -> Selection:
    """Add terms while that pays, then test again what is there.

    It ends early where nothing is left that a candidate promises to explain, and nothing that none can.
    """
    steps = Steps(space, proposer, every)
    current = steps.fit_of([])
    offered = steps.candidates(current)
    for depth in range(_MOST_TERMS):
        announce(f"step {depth + 1}: {len(offered.candidates)} candidates", 0.1 + 0.7 * depth / _MOST_TERMS)
        best = steps.best_addition(current, offered)
        if best is None:
            break
        # An early term may have stood for two others that came later: it goes before the next is looked for.
        pruned = steps.pruned(best, offered.whitening)
        if len(pruned.terms) > _MOST_TERMS:
            return Selection(current, offered, steps.samples, exhausted=True)
        current = pruned
        if steps.space.settle(current.terms):
            current = steps.again(current, offered.whitening)
        # Responses hardly change by a term more. Only where they promise something are they simulated anew.
        offered = steps.carried_over(current, offered)
        unseen = steps.space.split_again(current.residual)
        if not (unseen or steps.promises(offered)):
            break
        current = steps.again(current, offered.whitening)
        offered = steps.candidates(current, steps.carried_over(current, offered))
    # What is not explained would be spread over the alternatives of every term: they would all seem tied.
    if steps.is_rough(current):
        return Selection(current, offered, steps.samples)
    announce("what else could explain it", 0.85)
    alternatives = Alternatives(steps)
    current, tied, evidence = alternatives.tested(current, offered)
    better = alternatives.against_forces(current, offered, tied)
    return Selection(current, offered, steps.samples, tied, evidence, better=better)
