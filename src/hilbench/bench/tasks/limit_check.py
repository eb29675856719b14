"""Compiled check of a sample: does any of its quantities exceed its report threshold?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hilbench.bench.tasks.limits import BELOW_LIMITS, LIMIT_REACHED, Levels, LimitReading
from hilbench.bench.tasks.task import PerSample
from hilbench.compiled import COUNT, TABLE, TABLE_WIDTH, entry_point, floats, integers, table_of
from hilbench.topology.sample import CycleSample, PlacesIn
from hilbench.twin.virtual_io import SYNCHRONIZED

Vector = NDArray[np.float64]
Table = NDArray[np.int64]

# Rows of the table: a sample, and places of sizes, estimates, then positions and set points of the axes in it; report
# thresholds of the sizes; figures; the model's values of the estimates; position differences of the axes.
_VALUES, _WORDS, _AT, _THRESHOLDS, _FIGURES, _MODELS, _OFF = range(7)
#: Figures: a cycle, s; the least difference of positions and ratio of estimates that are reported; 1 if there has been
#: a sample since the drives were enabled; 1 if a warning is on.
_CYCLE_S, _APART, _RATIO, _STARTED, _WARNED, _COUNT = range(6)
#: For each axis with the one after it: difference of their positions at the start, what their set points have added up
#: to since, and how far they are off that.
_AT_START, _COMMANDED, _SIZE, _OFF_ROWS = range(4)


#: look(place of the twin's status, table): QUIET where every quantity is below its threshold, and no
#: warning is on, as in nearly every cycle.
@entry_point(COUNT, TABLE)
def _look(status: int, table: Table) -> int:
    if len(table) == 0:
        return BELOW_LIMITS
    values, at, thresholds = (
        floats(table, _VALUES, (1,)),
        integers(table, _AT, (1,)),
        floats(table, _THRESHOLDS, (1,)),
    )
    figures, models, off = (
        floats(table, _FIGURES, (1,)),
        floats(table, _MODELS, (1,)),
        floats(table, _OFF, (1, 2)),
    )
    sizes, pairs = len(thresholds), off.shape[1]
    estimate = sizes
    position, command = estimate + len(models), estimate + len(models) + pairs + 1
    loud = 0 if figures[_WARNED] == 0.0 else 1
    for k in range(pairs):
        apart = values[at[position + k]] - values[at[position + k + 1]]
        if figures[_STARTED] == 0.0:
            off[_AT_START, k] = apart
        off[_COMMANDED, k] += (values[at[command + k]] - values[at[command + k + 1]]) * figures[_CYCLE_S]
        off[_SIZE, k] = abs(apart - off[_AT_START, k] - off[_COMMANDED, k])
        loud += not off[_SIZE, k] < figures[_APART]
    figures[_STARTED] = 1.0
    for k in range(sizes):
        loud += not -thresholds[k] < values[at[k]] < thresholds[k]
    if integers(table, _WORDS, (1,))[status] & SYNCHRONIZED != 0:
        for k in range(len(models)):
            ratio = values[at[estimate + k]] / models[k]
            loud += not (ratio > 0.0 and max(ratio, 1.0 / ratio) < figures[_RATIO])
    return BELOW_LIMITS if loud == 0 else LIMIT_REACHED


class LimitCheck:
    """Check of the signals `sizes` against `thresholds`; of `estimates` against the model's value of each by `ratio`;
    of the position differences of the axes with `positions` and `commands` against
    `least_difference`."""

    def __init__(
        self,
        sizes: Sequence[str],
        thresholds: Sequence[float],
        estimates: Sequence[tuple[str, float]],
        ratio: float,
        positions: Sequence[str] = (),
        commands: Sequence[str] = (),
        least_difference: float = 0.0,
        cycle_s: float = 0.0,
    ) -> None:
        self._at = PlacesIn([*sizes, *(name for name, _ in estimates), *positions, *commands])
        self._thresholds, self._models = np.array(thresholds), np.array([value for _, value in estimates])
        self._figures, self._off = np.zeros(_COUNT), np.zeros((_OFF_ROWS, max(len(positions) - 1, 0)))
        self._figures[[_CYCLE_S, _APART, _RATIO]] = cycle_s, least_difference, ratio
        self.of = PerSample(self._on)  #: a sample
        _look(0, np.zeros((0, TABLE_WIDTH), np.int64))  # compiled, or loaded, before a cycle waits for it

    def _on(self, sample: CycleSample) -> LimitReading:
        kept = (
            *(sample.reals, sample.wholes, self._at.of(sample), self._thresholds),
            *(self._figures, self._models, self._off),
        )
        return LimitReading(_look, type(sample).place("twin_status"), table_of(kept), kept)

    @property
    def apart(self) -> list[float]:
        """Position error of each axis relative to the one after it, at the last check."""
        apart: list[float] = self._off[_SIZE].tolist()
        return apart

    def warned(self, levels: Levels) -> None:
        """Set if a warning is on, so that the check reports small values, too."""
        self._figures[_WARNED] = not levels.quiet
