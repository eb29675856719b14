"""Terms that may be added to a fit, and which of them comes first where several explain as much."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilbench.diagnosis.terms import Term
from hilbench.plant.effects import EFFECTS, STATION_EFFECTS

#: Share of the sum of squares that is left without a term by which the term has to lower it, half of it on stretches
#: that no fit has seen; the same of a simple effect, without which no other is read aright.
LEAST_SHARE, _LEAST_SIMPLE_SHARE = 0.06, 0.01
#: Share of what is left by which two explanations may differ and be tied, and by which one has to be better.
TIED: Final = 0.03
#: Ratio from which one of two tied explanations is clearly more its own, or less unusual.
_CLEARLY: Final = 1.5
#: Share of what any order explains from which a whole one is named instead.
WHOLE: Final = 0.75
RANK: Final = {effect.id: place for place, effect in enumerate(EFFECTS + STATION_EFFECTS)}


@dataclass(frozen=True)
class Offer:
    """A term that may be added, with its start values."""

    term: Term
    left: float  #: sum of squares, with it
    own: float  #: share of its response that the present terms leave of it
    in_stretches: float  #: of a wave: what it explains with a phase of its own in every stretch

    @property
    def sizes(self) -> float:
        """Distance from neutral, in units of the term's usual size."""
        return float(np.linalg.norm(self.term.moved)) / self.term.size


def in_order(offers: list[Offer], as_simple: Collection[str] = ()) -> list[Offer]:
    """The simple first, then what leaves least; of those that leave the same, what is named first.

    as_simple: effects that are as simple in this recording.
    """
    waiting = sorted(
        offers, key=lambda offer: (offer.term.effect.removable and offer.term.effect.id not in as_simple, offer.left)
    )
    ordered = []
    while waiting:
        first = waiting[0]
        for other in waiting[1:]:
            if other.left <= (1.0 + TIED) * waiting[0].left and _is_preferred(other, first):
                first = other
        waiting.remove(first)
        ordered.append(first)
    return ordered


def _is_preferred(other: Offer, offer: Offer) -> bool:
    """True if another explanation that leaves as much is preferred.

    The simple one; then the one that changes less of what the present terms explain; then the one that is less unusual
    on such a machine; then the first in the table.
    """
    if other.term.effect.removable != offer.term.effect.removable:
        return not other.term.effect.removable
    for mine, its in ((offer.own, other.own), (1.0 / offer.sizes, 1.0 / other.sizes)):
        if max(mine, its) > _CLEARLY * min(mine, its):
            return its > mine
    return RANK[other.term.effect.id] < RANK[offer.term.effect.id]


def is_beside_a_whole_order(offer: Offer, whole: list[tuple[Term, float]]) -> bool:
    """True if a whole order explains nearly as much as this one that is not.

    whole: terms of whole orders, and what each explains with a phase of its own in every stretch, even if with one
    phase it explains too little to be offered: then an order near it is not offered either.
    """
    return not offer.term.held and any(
        other.key == offer.term.key and explained >= WHOLE * offer.in_stretches for other, explained in whole
    )


def least_share(term: Term) -> float:
    return LEAST_SHARE if term.effect.removable else _LEAST_SIMPLE_SHARE
