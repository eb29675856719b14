"""Some of the stands by which `tools/history_stands.py` measures how often what is said of a trend is right."""

from __future__ import annotations

import numpy as np
from tools.history_stands import DAYS, KINDS, reported, stand

SEEDS = range(4)


def test_friction_that_grows_a_percent_a_day_is_reported_by_day_7() -> None:
    looked = [stand(seed, kind, wears=True) for kind in KINDS for seed in SEEDS]
    rising = [any(reported(each.after(day)) == "rising" for day in (5, 6, 7)) for each in looked]
    assert sum(rising) >= 18


def test_stands_that_stay_have_no_trend() -> None:
    looked = [stand(seed, kind, wears=False) for kind in KINDS for seed in SEEDS]
    for day in (7, DAYS - 1):
        assert sum(reported(each.after(day)) is not None for each in looked) <= 1


def test_a_stand_is_the_same_each_time() -> None:
    first, again = (stand(3, "outliers", wears=True) for _ in range(2))
    assert np.array_equal(first.friction_N, again.friction_N)
    assert reported(first.after(7)) == reported(again.after(7))
