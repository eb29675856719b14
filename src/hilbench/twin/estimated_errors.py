"""What a twin has found of its machine beside what it follows: errors of its model, as effects of the vocabulary."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class EstimatedModelError:
    """A parameter of an effect as the machine has it by the data: the model's own and what was found beyond it.

    `place`: where, as the history of a stand names it: ``axis2``, or what the kind of machine calls it. `deviation`:
    standard deviation, in the unit of the parameter. Not `separable`: the data don't tell it; value and deviation are
    what was assumed. `tied_with`: effects that do the same to the data: the value is that where they are not there.
    """

    effect: str
    parameter: str
    place: str
    value: float
    deviation: float
    separable: bool
    tied_with: tuple[str, ...] = ()


def as_text(found: Sequence[EstimatedModelError]) -> str:
    """As it stands in 2103h of the virtual I/O."""
    return json.dumps([asdict(each) for each in found], separators=(",", ":"))


def read_text(text: str) -> list[EstimatedModelError]:
    """The same, read. Raises ValueError for what is none of it."""
    try:
        rows: list[dict[str, Any]] = json.loads(text) if text else []
        return [EstimatedModelError(**row | {"tied_with": tuple(row.get("tied_with", ()))}) for row in rows]
    except TypeError as error:
        raise ValueError(f"{error}, expected parameters of effects") from None
