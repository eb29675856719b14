"""Normal numbers of sensors, step by step, for compiled callers; drawn by a `hilbench.plant.sensors.SensorNoise`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import table_of
from hilbench.cycle_program import CompiledStage, Function
from hilbench.plant.sensors import SensorNoise

#: In place of the next step's row: one row for all steps.
ALWAYS_FIRST = -1


def silence(motors: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Numbers (1, 3 M), and the row of the next step (1,), without noise."""
    return np.full((1, 3 * motors), -0.0), np.array([ALWAYS_FIRST])  # adding -0.0 keeps the sign


def chained_with_noise(
    function: Function, argument: int, vectors: Sequence[Any], noise: SensorNoise | None
) -> CompiledStage:
    """Compiled stage of a step, by a function that takes the next row, and does nothing where there is none."""
    table = table_of(vectors)

    def draw(_: int) -> bool:
        assert noise is not None, "silence does not end"
        noise.draw()
        function(argument, table)
        return True

    return CompiledStage(function, argument, vectors, fallback=draw, table=table)
