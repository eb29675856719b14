"""Measures what `hilbench history` says of 200 seeded stands, half of which wear: history_stands.py [--picture FILE].

A stand has one to four runs on most days, about one day in five none. A run states a deviation of 0.3 to 0.6 % and
repeats worse than that, by 1 %. Beside that each stand is of one kind: nothing else; days that vary by 0.5 % or 1 % and
are alike on neighbouring days (correlation time two days: temperature); a part that was exchanged (a step of 3 to
20 %); runs that are off (one of twenty, by 5 to 20 %). Of the stands that wear the friction grows by 1 % a day.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.apps.history.page import picture
from hilbench.apps.history.quantities import SECONDS_PER_DAY, quantities_of
from hilbench.apps.history.store import Quantity, Row
from hilbench.apps.history.trend import Trend, trend

Array = NDArray[np.float64]

KINDS: Final = ("plain", "temperature 0.5 %", "temperature 1 %", "step", "outliers")
STANDS: Final = 200
DAYS: Final = 30
WEAR_PER_DAY: Final = 0.01
#: Friction at the start, N.
_FRICTION_N: Final = 8.0
_REPEAT: Final = 0.01
_MISSING: Final = 0.2
_CORRELATED_D: Final = 2.0
_BEGAN_S: Final = 1_772_582_400.0  # 2026-03-04


@dataclass(frozen=True)
class Stand:
    """Runs of a stand: days, friction that each found, N, and its stated standard deviation, N."""

    kind: str
    wears: bool
    t: Array
    friction_N: Array
    stated_N: Array

    def after(self, day: int) -> Trend | None:
        """What the history says after the runs of a day, counted from 0."""
        known = self.t < day + 1
        if np.count_nonzero(known) < 2:
            return None
        return trend(self.t[known], self.friction_N[known], self.stated_N[known])


def stand(seed: int, kind: str, *, wears: bool, days: int = DAYS) -> Stand:
    """One of them; the same seed gives the same stand."""
    rng = np.random.default_rng([seed, KINDS.index(kind), wears])
    # One of a day at least at its start: a history begins with a run.
    per_day = rng.integers(1, 5, days) * ((rng.random(days) > _MISSING) | (np.arange(days) == 0))
    t = np.sort(np.repeat(np.arange(days, dtype=np.float64), per_day) + rng.uniform(0.3, 0.7, per_day.sum()))
    n = len(t)
    stated = rng.uniform(0.003, 0.006, n)
    off = np.hypot(stated, _REPEAT) * rng.standard_normal(n) + (WEAR_PER_DAY * t if wears else 0.0)
    if kind.startswith("temperature"):
        size = float(kind.split()[1]) / 100.0
        alike = np.exp(-np.abs(t[:, None] - t[None, :]) / _CORRELATED_D) + 1e-9 * np.eye(n)
        off += size * np.linalg.cholesky(alike) @ rng.standard_normal(n)
    elif kind == "step":
        off += rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.2) * (t > rng.uniform(3.0, days - 3.0))
    elif kind == "outliers":
        far = rng.random(n) < 0.05
        off += far * rng.choice([-1.0, 1.0], n) * rng.uniform(0.05, 0.2, n)
    return Stand(kind, wears, t, _FRICTION_N * (1.0 + off), _FRICTION_N * stated)


def reported(found: Trend | None) -> str | None:
    """The direction of a trend that is reported."""
    return None if found is None else found.direction


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--picture", type=Path, help="write the picture of one stand (SVG) instead")
    parser.add_argument("--daily", action="store_true", help="look at the stands that stay every day as well (slow)")
    given = parser.parse_args()
    if given.picture is not None:
        given.picture.write_bytes(_picture())
        return
    each = STANDS // len(KINDS)
    print(f"{'kind':20}{'grows: by day 5':>17}{'by day 7':>10}{'stays: day 7':>14}{'day 30':>8}{'ever':>8}")
    total: Counter[str] = Counter()
    for kind in KINDS:
        counts = Counter(_judged(kind, range(each), daily=given.daily))
        total += counts
        _print(kind, counts, each)
    _print("all", total, STANDS)


def _picture() -> bytes:
    """A stand that wears, whose bearing was exchanged after two weeks."""
    shown = stand(3, "temperature 0.5 %", wears=True)
    friction_N = shown.friction_N - 1.1 * (shown.t > 14.0)
    friction = "axis2.coulomb_friction.force_N"
    found = zip(shown.t, friction_N, shown.stated_N, strict=True)
    rows = [
        Row(str(run), "diagnosis", _BEGAN_S + SECONDS_PER_DAY * t, Quantity(friction, value, stated, "N"))
        for run, (t, value, stated) in enumerate(found)
    ]
    (quantity,) = quantities_of(rows, {friction: 12.0})
    return picture("docs", quantity).as_file("svg")


def _judged(kind: str, seeds: Sequence[int], *, daily: bool) -> list[str]:
    found = []
    for seed in seeds:
        wearing, staying = (stand(seed, kind, wears=wears) for wears in (True, False))
        rising = [reported(wearing.after(day)) == "rising" for day in (4, 5, 6, 7)]
        found += ["5"] * any(rising[:2]) + ["7"] * any(rising)
        false = {day: reported(staying.after(day)) is not None for day in (range(3, DAYS) if daily else (7, DAYS - 1))}
        found += ["false 7"] * false[7] + ["false 30"] * false[DAYS - 1] + ["ever"] * any(false.values())
        held = wearing.after(7)
        if held is not None:
            low, high = held.rate_ci95
            found += ["held"] * (low <= WEAR_PER_DAY * _FRICTION_N <= high)
    return found


def _print(name: str, counts: Counter[str], stands: int) -> None:
    shares = [100.0 * counts[key] / stands for key in ("5", "7", "false 7", "false 30", "ever", "held")]
    print(
        f"{name:20}"
        + "".join(f"{share:{width}.1f}" for share, width in zip(shares, (17, 10, 14, 8, 8, 8), strict=True)),
        flush=True,
    )


if __name__ == "__main__":
    main()
