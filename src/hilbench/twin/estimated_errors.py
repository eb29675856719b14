"""Model errors estimated by a twin, as effects of the vocabulary."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class EstimatedModelError:
    """Estimated parameter of an effect: the model's own and the error found beyond it.

    `place`: location as in a bench's history: ``axis2``, or a name of the kind of machine. `deviation`: standard
    deviation, in the unit of the parameter. Not `separable`: not identified; value and deviation are the prior.
    `tied_with`: effects with the same influence on the data: the value holds without them.
    """

    effect: str
    parameter: str
    place: str
    value: float
    deviation: float
    separable: bool
    tied_with: tuple[str, ...] = ()


def as_text(found: Sequence[EstimatedModelError]) -> str:
    """JSON text for 2103h of the virtual I/O."""
    return json.dumps([asdict(each) for each in found], separators=(",", ":"))


def read_text(text: str) -> list[EstimatedModelError]:
    """Parse the text of 2103h. Raises ValueError for other text."""
    try:
        rows: list[dict[str, Any]] = json.loads(text) if text else []
        return [EstimatedModelError(**row | {"tied_with": tuple(row.get("tied_with", ()))}) for row in rows]
    except TypeError as error:
        raise ValueError(f"{error}, expected parameters of effects") from None
