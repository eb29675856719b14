"""Compiled check of a sample: does any of its quantities exceed its report threshold?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

import numpy as np

from hilbench.bench.tasks.limits import BELOW_LIMITS, LIMIT_REACHED, Levels, LimitReading
from hilbench.bench.tasks.task import PerSample
from hilbench.compiled import COUNT, TABLE, Reals, Wholes, Wholes2, arrays_in, entry_point, load, record_type
from hilbench.topology.sample import CycleSample
from hilbench.twin.virtual_io import SYNCHRONIZED

#: A cycle, s; the least difference of positions and ratio of estimates that are reported; 1 if there has been a sample
#: since the drives were enabled; 1 if a warning is on.
_FIGURES = record_type("cycle_s", "apart", "ratio", "started", "warned")


class _Arrays(NamedTuple):
    """A sample; places in it of sizes, with their report thresholds, of estimates, with the model's values, and of
    positions and set points of the axes; for each axis with the one after it the difference of their positions at the
    start, what their set points have added up to since, and how far they are off that."""

    values: Reals
    words: Wholes
    sizes_at: Wholes
    thresholds: Reals
    estimates_at: Wholes
    models: Reals
    positions_at: Wholes
    commands_at: Wholes
    at_start: Reals
    commanded: Reals
    off: Reals
    figures: Annotated[Any, _FIGURES]


#: look(place of the twin's status, table of `_Arrays`): BELOW_LIMITS where every quantity is below its threshold, and
#: no warning is on, as in nearly every cycle.
@entry_point(COUNT, TABLE)
def _look(status: int, table: Wholes2) -> int:
    a = arrays_in(table, _Arrays)
    values, figures = a.values, a.figures
    loud = 0 if figures.warned == 0.0 else 1
    for k in range(len(a.off)):
        apart = values[a.positions_at[k]] - values[a.positions_at[k + 1]]
        if figures.started == 0.0:
            a.at_start[k] = apart
        a.commanded[k] += (values[a.commands_at[k]] - values[a.commands_at[k + 1]]) * figures.cycle_s
        a.off[k] = abs(apart - a.at_start[k] - a.commanded[k])
        loud += not a.off[k] < figures.apart
    figures.started = 1.0
    for k in range(len(a.thresholds)):
        loud += not -a.thresholds[k] < values[a.sizes_at[k]] < a.thresholds[k]
    if a.words[status] & SYNCHRONIZED != 0:
        for k in range(len(a.models)):
            ratio = values[a.estimates_at[k]] / a.models[k]
            loud += not (ratio > 0.0 and max(ratio, 1.0 / ratio) < figures.ratio)
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
        names = [name for name, _ in estimates]
        self._signals = sizes, names, positions, commands
        self._thresholds, self._models = np.array(thresholds), np.array([value for _, value in estimates])
        self._off = np.zeros(max(len(positions) - 1, 0))
        self._since_start = np.zeros_like(self._off), np.zeros_like(self._off)
        self._figures = np.array([(cycle_s, least_difference, ratio, 0.0, 0.0)], _FIGURES)
        self.of = PerSample(self._on)  #: a sample
        load(_look)

    def _on(self, sample: CycleSample) -> LimitReading:
        sizes, estimates, positions, commands = map(type(sample).places, self._signals)
        arrays = _Arrays(
            *(sample.reals, sample.wholes, sizes, self._thresholds, estimates, self._models, positions, commands),
            *(*self._since_start, self._off, self._figures),
        )
        return LimitReading(_look, type(sample).place("twin_status"), arrays)

    @property
    def apart(self) -> list[float]:
        """Position error of each axis relative to the one after it, at the last check."""
        apart: list[float] = self._off.tolist()
        return apart

    def warned(self, levels: Levels) -> None:
        """Set if a warning is on, so that the check reports small values, too."""
        self._figures["warned"] = not levels.quiet
