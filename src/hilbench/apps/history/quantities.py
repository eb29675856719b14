"""A stand's quantities with their trends, from the rows of its history."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np

from hilbench.apps.history.store import Row
from hilbench.apps.history.trend import Trend, trend
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError

SECONDS_PER_DAY: Final = 86400.0
#: How far ahead of the last run a band goes, as a share of the time that is known.
_AHEAD: Final = 0.5


@dataclass(frozen=True)
class QuantityTrend:
    """A quantity as the runs of a stand found it, in the order of time, and its trend (None: not yet possible).

    Days count from `first_time_s`, s since 1970.
    """

    name: str
    unit: str
    rows: Sequence[Row]
    limit: float | None
    trend: Trend | None

    @property
    def first_time_s(self) -> float:
        """When the first run was, s since 1970."""
        return self.rows[0].time_s

    def time_s(self, day: float) -> float:
        """A time on the axis of the trend, s since 1970."""
        return self.first_time_s + SECONDS_PER_DAY * day

    @property
    def stated_sd(self) -> float:
        """Median of the deviations that the runs state."""
        return float(np.median([row.quantity.sd for row in self.rows]))

    @property
    def days(self) -> int:
        """On how many days (UTC) there was a run."""
        return len({int(row.time_s // SECONDS_PER_DAY) for row in self.rows})


def quantities_of(rows: Sequence[Row], limits: Mapping[str, float]) -> Iterator[QuantityTrend]:
    """Each quantity of a stand with its trend; `rows` by quantity and time, as a history gives them.

    limits: values by quantity of which it is asked when they are reached. Raises UnusableInputError for a limit of a
    quantity that no run has found.
    """
    names = {row.quantity.name for row in rows}
    for name in limits:
        if name not in names:
            known = expected_one_of(name, sorted(names) or ["none yet"])
            raise UnusableInputError("limit", f"no run has found '{name}'{known}")
    for (name, unit), group in groupby(rows, key=lambda row: (row.quantity.name, row.quantity.unit)):
        found, limit = list(group), limits.get(name)
        first = found[0].time_s
        days = np.array([(row.time_s - first) / SECONDS_PER_DAY for row in found])
        values, deviations = np.array([(row.quantity.value, row.quantity.sd) for row in found]).T
        ahead_d = _AHEAD * float(days[-1])
        limits_ahead = () if limit is None else (limit,)
        yield QuantityTrend(
            name, unit, found, limit, trend(days, values, deviations, limits=limits_ahead, ahead_d=ahead_d)
        )
