"""Normal numbers of sensors, step by step, for compiled callers; those of a `hilbench.plant.sensors.SensorNoise`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import compiled, table_of
from hilbench.cycle_program import CompiledStage, Function
from hilbench.plant.sensors import SensorNoise

#: In the place of the row of the next step: there is one row for all of them.
_ALWAYS_FIRST = -1


def silence(motors: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Numbers (1, 3 M), and the row of the next step (1,), without any noise."""
    return np.full((1, 3 * motors), -0.0), np.array([_ALWAYS_FIRST])  # what -0.0 is added to keeps its sign


@compiled
def take_row(rows: NDArray[np.float64], next_row: NDArray[np.int64]) -> int:
    """Which of the rows (B, 3 M) are the numbers of this step; -1: they are to be drawn anew."""
    at = next_row[0]
    if at == _ALWAYS_FIRST:
        return 0
    if at == len(rows):
        return -1
    next_row[0] += 1
    return int(at)


def chained_with_noise(
    function: Function, argument: int, vectors: Sequence[NDArray[Any]], noise: SensorNoise | None
) -> CompiledStage:
    """A step as a piece of a cycle, of a function that takes a row as above, and does nothing where there is none."""
    table = table_of(vectors)

    def draw(_: int) -> bool:
        assert noise is not None, "silence does not end"
        noise.draw()
        function(argument, table)
        return True

    return CompiledStage(function, argument, table, fallback=draw, keeps=vectors)
