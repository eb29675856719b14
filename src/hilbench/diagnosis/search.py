"""Which terms the data ask for: one stepwise search, forward and backward.

Every candidate is a column of responses beside those of the terms that are there. Terms are added while that pays, what
the others have made superfluous goes, and at the end each must show that the data are explained worse without it, and
that no other explains them as well: equal ones are tied with it.

What an addition costs, what has to confirm it and what ties two explanations are the rules of a kind of prediction: of
one whose right model leaves noise alone, and of measured motion, where it does not.

How often that is right: tools/diagnose_scoreboard.py, tools/diagnose_rigs.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Callable

from hilbench.diagnosis.alternatives import FreeRules
from hilbench.diagnosis.select_measured import MeasuredRules
from hilbench.diagnosis.selection import Selection

Announce = Callable[[str, float], None]


def search(rules: FreeRules | MeasuredRules, announce: Announce = lambda text, share: None) -> Selection:
    """Add terms while that pays, then judge what is there."""
    current = rules.fit_of([])
    offered = rules.candidates(current)
    for depth in range(rules.most_terms):
        announce(f"step {depth + 1}: {len(offered.candidates)} candidates", 0.1 + 0.7 * depth / rules.most_terms)
        best = rules.best_addition(current, offered)
        if best is None:
            break
        if len(best.terms) > rules.most_terms:
            return Selection(current, offered, rules.samples, exhausted=True)
        current, offered, promising = rules.continued(best, offered)
        if not promising:
            break
    announce("what else could explain it", 0.85)
    return rules.judged(current, offered)
