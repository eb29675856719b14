"""A stand's quantities with their trends, from the rows of its history, as sentences or as data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from math import isfinite
from typing import Any, Final

import numpy as np

from hilbench.apps.history.store import Row
from hilbench.apps.history.trend import Change, Trend, trend
from hilbench.did_you_mean import expected_one_of
from hilbench.errors import UnusableInputError

SECONDS_PER_DAY: Final = 86400.0
#: How far ahead of the last run a band goes, as a share of the time that is known.
_AHEAD: Final = 0.5
#: Beyond so many days no date is said.
FAR_D: Final = 36500.0
_NORMAL_95: Final = 1.959964


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
        """Time of the first run, s since 1970."""
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
        """Number of days (UTC) with a run."""
        return len({int(row.time_s // SECONDS_PER_DAY) for row in self.rows})


def quantities_of(rows: Sequence[Row], limits: Mapping[str, float]) -> Iterator[QuantityTrend]:
    """Each quantity of a stand with its trend; `rows` by quantity and time, as a history gives them.

    limits: values by quantity whose time of arrival is predicted. Raises UnusableInputError for a limit of a
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
        yield QuantityTrend(name, unit, found, limit, trend(days, values, deviations, limit=limit, ahead_d=ahead_d))


def moment(time_s: float) -> str:
    """A time (s since 1970), UTC, ISO 8601."""
    return datetime.fromtimestamp(time_s, UTC).isoformat(timespec="seconds")


def date(time_s: float) -> str:
    """The day of a time (s since 1970), UTC."""
    return moment(time_s)[:10]


COLUMNS: Final = ("Quantity", ">Runs", ">Days", ">Now", "95 %", ">Per day", "95 %", "Unit", "Trend")


def figures(one: QuantityTrend) -> list[str]:
    """A table's text, a cell for each of `COLUMNS`."""
    found, counted = one.trend, (one.name, str(len(one.rows)), str(one.days))
    if found is None:
        last = one.rows[-1].quantity
        return [*counted, f"{last.value:.5g}", f"± {_NORMAL_95 * last.sd:.2g}", "", "", one.unit, "one run or day"]
    level, rate = (0.5 * (high - low) for low, high in (found.level_ci95, found.rate_ci95))
    now, per_day = (f"{found.level:.5g}", f"± {level:.2g}"), (f"{found.rate_per_d:+.2g}", f"± {rate:.2g}")
    return [*counted, *now, *per_day, one.unit, found.direction or "none seen"]


def sentences(one: QuantityTrend) -> list[str]:
    """Sentences on a quantity in addition to its figures: its changes, and when its limit is reached."""
    found, lines = one.trend, []
    for change in () if found is None else found.changes:
        if change.kind == "outlier":
            lines.append(f"the run of {_day(one, change.after_d)} is off by {change.size:+.3g} {one.unit}".rstrip())
            continue
        between = f"between {_day(one, change.after_d)} and {_day(one, change.before_d)}"
        per = "" if change.kind == "step" else " per day"
        what = "changed" if change.kind == "step" else "its trend changed"
        lines.append(f"{what} {between} by {change.size:+.3g} ± {1.96 * change.sd:.2g} {one.unit}".rstrip() + per)
    tied = [row.quantity.tied_with for row in one.rows if row.quantity.tied_with]
    if tied:
        others = ", ".join(sorted({name for each in tied for name in each.split(", ")}))
        lines.append(f"in {len(tied)} of {len(one.rows)} runs it could not be distinguished from {others}")
    if one.limit is not None:
        lines.append(_limit_sentence(one))
    return lines


def _limit_sentence(one: QuantityTrend) -> str:
    assert one.limit is not None, "asked of quantities that have one"
    limit = f"limit {one.limit:g} {one.unit}".rstrip()
    if one.trend is None or one.trend.reached is None:
        return f"{limit}: no trend towards it is seen"
    reached, last_s = one.trend.reached, one.rows[-1].time_s

    def date_text(day: float) -> str:
        return date(last_s + SECONDS_PER_DAY * day) if day < FAR_D else "never"

    between = f"{date_text(reached.from_d)} to {date_text(reached.to_d)}"
    return f"{limit} is reached {date_text(reached.median_d)} (90 %: {between})"


def _day(one: QuantityTrend, day: float) -> str:
    return moment(one.time_s(day))[:16].replace("T", " ")


def as_data(one: QuantityTrend) -> dict[str, Any]:
    """Data for a program; times are ISO 8601, UTC, rates per day."""
    found = one.trend
    return {
        "quantity": one.name,
        "unit": one.unit,
        "runs": len(one.rows),
        "days": one.days,
        "first": moment(one.first_time_s),
        "last": moment(one.rows[-1].time_s),
        "stated_sd": one.stated_sd,
        "trend": found and found.direction,
        "level": found and {"value": found.level, "ci95": list(found.level_ci95)},
        "rate_per_day": found and {"value": found.rate_per_d, "ci95": list(found.rate_ci95)},
        **{name: found and getattr(found, name) for name in ("sure", "repeat_sd", "daily_sd")},
        "changes": [_change(one, change) for change in found.changes] if found else [],
        "limit": None if one.limit is None else {"value": one.limit, "reached": _reached(one)},
        "values": [
            {"run": row.run, "source": row.source, "time": moment(row.time_s)}
            | {name: getattr(row.quantity, name) for name in ("value", "sd", "tied_with")}
            for row in one.rows
        ],
    }


def _change(one: QuantityTrend, change: Change) -> dict[str, Any]:
    between = {"after": moment(one.time_s(change.after_d)), "before": moment(one.time_s(change.before_d))}
    return {"kind": change.kind, **between, "size": change.size, "sd": change.sd, "probability": change.probability}


def _reached(one: QuantityTrend) -> dict[str, Any] | None:
    if one.trend is None or one.trend.reached is None:
        return None
    reached, last_s = one.trend.reached, one.rows[-1].time_s
    days = {"expected": reached.median_d, "from": reached.from_d, "to": reached.to_d}
    return {
        f"{name}{suffix}": value
        for name, day in days.items()
        for suffix, value in (
            ("", moment(last_s + SECONDS_PER_DAY * day) if isfinite(day) and day < FAR_D else None),
            ("_days", day if isfinite(day) else None),
        )
    }
