"""Base of followers that follow measured motion in one compiled call a cycle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import TABLE_WIDTH, Vector, table_of
from hilbench.cycle_program import CompiledStage, Function
from hilbench.plant.measured_motion import HasFollowed


class CompiledInStep(ABC):
    """`InStep` by a compiled `function` of a table of `arrays`, a NamedTuple, with the process image's `values` and
    offsets `at` in it; it returns `followed` if the cycle is complete. `torques_Nm`: one of them, for the load motors'
    torques (M,)."""

    def __init__(self, function: Function, followed: int, torques_Nm: Vector, arrays: Any) -> None:
        self._function, self._followed = function, followed
        self._torques, self._arrays = torques_Nm, arrays
        self._table = np.zeros((0, TABLE_WIDTH), np.int64)

    @property
    def torques_Nm(self) -> list[float]:
        """Load torques; see `InStep`."""
        torques_Nm: list[float] = self._torques.tolist()
        return torques_Nm

    def follow(self, values: Vector, places: NDArray[np.int64], *, late: bool) -> HasFollowed:
        """Follow a cycle; see `InStep`."""
        return self.has_followed(self._function(int(late), self._table_on(values, places)))

    def piece(self, values: Vector, places: NDArray[np.int64], fallback: Callable[[int], bool]) -> CompiledStage:
        """Compiled stage; see `InStep`."""
        table = self._table_on(values, places)
        return CompiledStage(self._function, 0, self._arrays, continues=self._followed, fallback=fallback, table=table)

    @abstractmethod
    def has_followed(self, code: int) -> HasFollowed:
        """Result by return code; see `InStep`."""

    def _table_on(self, values: Vector, places: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._arrays.values is not values or self._arrays.at is not places:
            self._arrays = self._arrays._replace(values=values, at=places)
            self._table = table_of(self._arrays)
        return self._table
