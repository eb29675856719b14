"""Changes that the bench makes in a run and no frame on the bus shows, with their cycles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

What = Literal[
    "enabled",
    "set",
    "twin_lost",
    "twin_back",
    "loop_open",
    "loop_closed",
    "predicted",
    "stopping",
    "gap_seen",
    "effect_named",
    "effect_gone",
    "effect_dismissed",
    "model_proposed",
    "model_refused",
    "model_applied",
    "model_announced",
    "asked",
]


@dataclass(frozen=True)
class Change:
    """Change made by the bench between two cycles.

    `cycle` counts SYNCs: the change acts from the one after it. ``enabled``: the experiment's time begins;
    ``set``: the quantity `path` (`hilbench.topology.quantities`) had `before` and has `value` from now on;
    ``twin_lost``: the twin is not relied on any more; ``twin_back``: it is again, and counts the SYNCs after number
    `value`; ``loop_open``: the tension loop `path` is open since `value` s, for long; ``loop_closed``: it is closed
    again; ``predicted``: the signal `path` was predicted to go beyond the level
    `value`, with the probability `before`; ``stopping``: the drives are brought to a stop.
    Of the live diagnosis: ``gap_seen``: model and measurement differ since `value` s; ``effect_named``,
    ``effect_gone``: by the effect `path`, whose strength has `value`; ``effect_dismissed``: new data did not confirm
    that; ``model_proposed``, ``model_refused``: the twin could use, or is not to use, that model; ``model_applied``:
    it does; ``model_announced``: the machine has got `path` on purpose.
    ``asked``: a person (`who`) at a monitor has done what `path` says; such a line is the monitor's, and its cycle the
    last one that it had received.
    """

    cycle: int
    what: What
    path: str = ""
    value: float = 0.0
    before: float | None = None
    who: str | None = None
