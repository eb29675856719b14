"""What a new bench needs beyond what every bench is asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

#: A key of the config, from its root.
Place = tuple[str, ...]


@dataclass(frozen=True)
class NewBench:
    """A machine of one kind: simulated drives, and a first experiment that can be run."""

    questions: tuple[tuple[str, Place, Any], ...]  #: question, place of the answer, what is suggested
    given: Mapping[Place, Any]  #: what nobody is asked for
    nodes: Mapping[Place, int]  #: where each node stands, and its id
    virtual_io: str = "hilbench_virtual_io.eds"  #: EDS file of the twin's virtual I/O
