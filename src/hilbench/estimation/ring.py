"""Places of the last values in arrays of a fixed length, of which several share one ring; compiled.

Values are numbered from the oldest to the newest.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hilbench.compiled import Record, inlined

#: Index of the oldest value, and number of values.
RING: Final = np.dtype([("first", "i8"), ("count", "i8")])


@inlined
def push(ring: Record, capacity: int) -> int:
    """Index for the newest value; in full arrays that of the oldest, which it replaces."""
    place = ring.first + ring.count
    if ring.count < capacity:
        ring.count += 1
    else:
        ring.first = ring.first + 1 if ring.first + 1 < capacity else 0
    return int(place if place < capacity else place - capacity)


@inlined
def place(ring: Record, capacity: int, number: int) -> int:
    """Index of a value by its number, from 0, the oldest."""
    at = ring.first + number
    return int(at if at < capacity else at - capacity)


@inlined
def clear(ring: Record) -> None:
    """Forget all values."""
    ring.first = 0
    ring.count = 0
