"""What is shown while one model goes over into another, without steps that are of the change.

Between two models that follow the same web there is a difference, of which more and more is shown. It jumps where they
take a late sample, or some cycles without measurement, differently, or where the one that is left diverges. Such a
jump is shown as a slope: what both models do is followed at once, the rest by no more than a small step in each cycle.
A difference that goes to and fro with a roller changes by less than that, and is shown as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign


class BumplessTransfer:
    """`largest_steps`: of each value what may be of the change in a cycle; of values behind these, anything."""

    def __init__(self, largest_steps: Sequence[float]) -> None:
        self._largest = tuple(largest_steps)
        self._old: Sequence[float] = ()
        self._new: Sequence[float] = ()
        self._shown: Sequence[float] = ()
        self.is_over = True  #: whether what is shown is what the models make of it

    def show(self, old: Sequence[float], new: Sequence[float], share: float) -> list[float]:
        """Of a cycle in which this share of the new model is to be shown, in the place of that much of the old one."""
        wanted = [then + share * (now - then) for then, now in zip(old, new, strict=True)]
        shown = list(wanted)
        if self._shown:
            for at, largest in enumerate(self._largest):
                alone, both = new[at] - self._new[at], old[at] - self._old[at]
                follows = self._shown[at] + (alone if share == 1.0 else _of_both(alone, both))
                if abs(wanted[at] - follows) > largest:
                    shown[at] = follows + copysign(largest, wanted[at] - follows)
        self._old, self._new, self._shown = old, new, shown
        self.is_over = shown == wanted
        return shown


def _of_both(old: float, new: float) -> float:
    """By how much two values that have changed by this have both changed."""
    return 0.0 if old * new <= 0.0 else min(old, new, key=abs)
