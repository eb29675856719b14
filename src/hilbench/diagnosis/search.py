"""Stepwise search of the terms that the data ask for, forward and backward.

Every candidate is a column of responses. Terms are added while that pays, superfluous ones go, and at the end each must
show that the data are explained worse without it, and that no other explains them as well: equal ones are tied. Price,
hold-out and ties are the rules of a kind of prediction: one whose right model leaves noise alone, or measured motion.
How often that is right: tools/diagnose_scoreboard.py, tools/diagnose_rigs.py, docs/diagnosis_method.md.
"""

from __future__ import annotations

from collections.abc import Callable

from hilbench.diagnosis.free_rules import FreeRules
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
        # An early term may have stood for two others that came later: it goes before the next is looked for.
        best = rules.pruned(best, offered.whitening)
        if len(best.terms) > rules.most_terms:
            return Selection(current, offered, exhausted=True)
        current, offered, promising = rules.continued(best, offered)
        if not promising:
            break
    announce("what else could explain it", 0.85)
    return rules.judged(current, offered)
