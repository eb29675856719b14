"""Bumpless transfer of outputs from one model to another.

Two models of the same web differ, and the output goes from one to the other. Their difference jumps where they take a
late sample, or some cycles without measurement, differently, or where the old one diverges. Such a jump is output as a
slope: common changes of both models are followed at once, the rest by no more than a small step in each cycle. A
difference that oscillates with a roller changes by less than that, and is output unchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import copysign


class BumplessTransfer:
    """Output step limiter. `largest_steps`: largest step of each value by the transfer per cycle; others are
    unlimited."""

    def __init__(self, largest_steps: Sequence[float]) -> None:
        self._largest = tuple(largest_steps)
        self._old: Sequence[float] = ()
        self._new: Sequence[float] = ()
        self._shown: Sequence[float] = ()
        self.is_over = True  #: the output equals the models' blend

    def show(self, old: Sequence[float], new: Sequence[float], share: float) -> list[float]:
        """Outputs of a cycle with this share of the new model in place of the old one."""
        wanted = [then + share * (now - then) for then, now in zip(old, new, strict=True)]
        shown = list(wanted)
        if self._shown:
            for at, largest in enumerate(self._largest):
                alone, both = new[at] - self._new[at], old[at] - self._old[at]
                if share != 1.0:  # the common part of both changes
                    alone = 0.0 if alone * both <= 0.0 else min(alone, both, key=abs)
                follows = self._shown[at] + alone
                if abs(wanted[at] - follows) > largest:
                    shown[at] = follows + copysign(largest, wanted[at] - follows)
        self._old, self._new, self._shown = old, new, shown
        self.is_over = shown == wanted
        return shown
