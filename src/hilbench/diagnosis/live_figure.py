"""A figure of a run on the bench, and what it is made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from hilbench.results.recording import Recording

#: Share of its highest speed above which a machine counts as working.
WORKS: Final = 0.2


@dataclass(frozen=True)
class LiveFigure:
    """One figure of a run."""

    name: str  #: with its unit, as `--json` prints it
    text: str  #: with its unit, for a person
    value: float


def signal(recording: Recording, name: str) -> np.ndarray:
    """(n,): a channel as numbers. Raises KeyError for one that is not there."""
    return np.asarray(recording[name], np.float64)
