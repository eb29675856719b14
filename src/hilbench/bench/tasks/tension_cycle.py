"""What a tension loop makes of a cycle, compiled: the controller's velocity, and the damping of the swing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks import swing_damping, tension_control
from hilbench.bench.tasks.swing_damping import SwingDamping, damp
from hilbench.bench.tasks.tension_control import TensionController, control
from hilbench.compiled import FLAG, TABLE, TABLE_WIDTH, entry_point, floats, number_of_sources, reals, table_of
from hilbench.plant import pairing

Table = NDArray[np.int64]
#: Line speed, set-point, tension, E, time since the controller's last step, what is known to be right already (NaN:
#: nothing), positions of the axes before and behind the span, what they are to show of its lengthening; as of `control`
#: and `damp`.
Now = tuple[float, float, float, float, float, float, float, float, float]


def table(controller: TensionController, damping: SwingDamping) -> Table:
    """Of the vectors of both, which keep them; `step` is compiled, or loaded, before anybody waits for a cycle."""
    step(False, (0.0,) * 9, np.zeros((0, TABLE_WIDTH), np.int64))
    return table_of((controller.figures, controller.state, *damping.vectors))


def _entry_point(sources: int) -> Callable[[bool, Now, Table], tuple[float, float]]:
    """For Python; `sources` as in `compiled.number_of_sources`."""

    @entry_point(FLAG, reals(9), TABLE)
    def step(closed: bool, now: Now, table: Table) -> tuple[float, float]:
        if sources < 0 or len(table) == 0:
            return 0.0, 0.0
        velocity_m_s = control(
            floats(table, 0, (1,)), floats(table, 1, (1,)), closed, now[0], now[1], now[2], now[3], now[4], now[5]
        )
        positions_m = floats(table, 6, (1,))
        positions_m[0], positions_m[1] = now[6], now[7]
        plant, gains, ways = floats(table, 2, (1,)), floats(table, 3, (1,)), floats(table, 4, (1,))
        return velocity_m_s, damp(plant, gains, ways, floats(table, 5, (1,)), positions_m, now[8])

    return step


#: step(whether the loop is closed, as it is now, table): velocity of the axis before the span, and what damps the swing
#: beside it, m/s.
step = _entry_point(
    number_of_sources(*(str(module.__file__) for module in (pairing, swing_damping, tension_control)), __file__)
)
