"""One cycle of a running bench, as the bench, its observers and conditions see it.

A sample is its signals in memory, one behind the other, each in eight bytes: compiled functions read and write
it as a vector, everybody else by the names of the signals.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from hilbench.topology.signal_kinds import Signal


class CycleSample:
    """The signals of a bench (`BenchConfig.signals`: units and meaning there), and the number of the cycle.

    Every bench has a class of its own, with its signals as attributes (`sample_type`). `reals` and `wholes`: all of it
    as binary64 and as int64, each signal at its `place`; those of one kind say nothing as the other.
    """

    __slots__ = ()

    if TYPE_CHECKING:
        cycle: int
        t_s: float
        twin_age_cycles: int
        twin_status: int
        loop_closed: int
        bus_bits: int
        reals: NDArray[np.float64]
        wholes: NDArray[np.int64]

        def __init__(self, **values: float) -> None: ...
        def __getattr__(self, name: str) -> float: ...
        def __setattr__(self, name: str, value: float) -> None: ...

    @classmethod
    def names(cls) -> list[str]:
        """The signals in their order, the number of the cycle behind them."""
        return [name for name, _ in cast("Any", cls)._fields_]

    @classmethod
    def place(cls, signal: str) -> int:
        """Index of a signal in the vectors. Raises AttributeError for a signal that this bench does not have."""
        return int(cast("Any", getattr(cls, signal)).offset // 8)

    @classmethod
    def places(cls, signals: Sequence[str]) -> NDArray[np.int64]:
        """Index of each signal in the vectors."""
        return np.array([cls.place(signal) for signal in signals], np.int64)


Made = TypeVar("Made")


class PerSample(Generic[Made]):
    """Cache of an object made on the vectors of a sample, which is mostly the same one."""

    def __init__(self, make: Callable[[CycleSample], Made]) -> None:
        self._make = make
        self._sample: CycleSample | None = None
        self._made: Made

    def __call__(self, sample: CycleSample) -> Made:
        """Object for this sample."""
        if sample is not self._sample:
            self._made, self._sample = self._make(sample), sample
        return self._made


def sample_type(signals: Sequence[Signal]) -> type[CycleSample]:
    """The class of a bench's samples: every signal an attribute, zero at first."""
    return _sample_type(tuple((signal.name, signal.integer) for signal in signals))


class _Structure(ctypes.Structure):
    """Structure with a vector view of all its fields."""

    __slots__ = ("reals", "wholes")
    reals: NDArray[np.float64]
    wholes: NDArray[np.int64]

    def __new__(cls, **values: float) -> Self:
        reals = np.zeros(ctypes.sizeof(cls) // 8)
        made = cls.from_buffer(reals.data)
        made.reals, made.wholes = reals, reals.view(np.int64)
        return made

    def __copy__(self) -> Self:
        made = type(self)()
        made.wholes[:] = self.wholes  # of both kinds, bit by bit
        return made

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.__copy__()

    def __repr__(self) -> str:
        return f"CycleSample({', '.join(f'{name}={getattr(self, name)!r}' for name, *_ in self._fields_)})"


@cache
def _sample_type(signals: tuple[tuple[str, bool], ...]) -> type[CycleSample]:
    named = [(name, ctypes.c_int64 if whole else ctypes.c_double) for name, whole in (*signals, ("cycle", True))]
    make = cast("Any", type(_Structure))
    return cast(
        "type[CycleSample]", make("CycleSample", (CycleSample, _Structure), {"_fields_": named, "__slots__": ()})
    )
