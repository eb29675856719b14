"""What a new bench needs beyond what every bench is asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

#: A key of the config, from its root.
Place = tuple[str | int, ...]
#: Gives the answer that stands at a place.
Answers = Callable[[Place], Any]
#: What is suggested: a value, or how it follows from the answers before.
Suggested = Any | Callable[[Answers], float]


@dataclass(frozen=True)
class NewBench:
    """A machine of one kind: simulated drives, and a first experiment that can be run."""

    questions: tuple[tuple[str, Place, Suggested], ...]  #: question, place of the answer, what is suggested
    given: Mapping[Place, Any]  #: what nobody is asked for
    nodes: Mapping[Place, int]  #: where each node stands, and its id
    follows: Mapping[Place, Callable[[Answers], float]] = field(default_factory=dict)  #: from the answers, unasked
    virtual_io: str = "hilbench_virtual_io.eds"  #: EDS file of the twin's virtual I/O


def rounded(value: float) -> float:
    """Four digits: as many as the demonstrator's sizes have, from which others are scaled."""
    return float(f"{value:.4g}")
