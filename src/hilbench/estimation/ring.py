"""Ring buffer in a slice of a flat vector; compiled.

A ring has a fixed capacity; its values are numbered from the oldest to the newest.
"""

from __future__ import annotations

from hilbench.compiled import inlined
from hilbench.estimation.bank import Array

_CAPACITY, _FIRST, _COUNT, _VALUES = range(4)


def size(capacity: int) -> int:
    """Elements of a vector that a ring occupies."""
    return _VALUES + capacity


def put(s: Array, at: int, capacity: int) -> int:
    """Create an empty ring at offset `at`; returns the first offset after it."""
    s[at : at + size(capacity)] = 0.0
    s[at + _CAPACITY] = capacity
    return at + size(capacity)


@inlined
def push(s: Array, at: int, value: float) -> None:
    """Append the newest value; a full ring drops the oldest."""
    capacity, first, count = int(s[at + _CAPACITY]), int(s[at + _FIRST]), int(s[at + _COUNT])
    if count < capacity:
        place = first + count
        s[at + _COUNT] = count + 1
    else:
        place = first
        s[at + _FIRST] = first + 1 if first + 1 < capacity else 0
    s[at + _VALUES + (place if place < capacity else place - capacity)] = value


@inlined
def value(s: Array, at: int, number: int) -> float:
    """Value by its number, from 0, the oldest."""
    capacity, place = int(s[at + _CAPACITY]), int(s[at + _FIRST]) + number
    return float(s[at + _VALUES + (place if place < capacity else place - capacity)])


@inlined
def count(s: Array, at: int) -> int:
    """Number of values."""
    return int(s[at + _COUNT])


@inlined
def is_full(s: Array, at: int) -> bool:
    """True if the next value drops the oldest."""
    return bool(s[at + _COUNT] == s[at + _CAPACITY])


@inlined
def clear(s: Array, at: int) -> None:
    """Forget all values."""
    s[at + _FIRST] = 0.0
    s[at + _COUNT] = 0.0
