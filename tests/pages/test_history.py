"""The last minutes of signals: nothing that was there is lost, however far one looks back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.apps.pages.live.history import LEVELS, History

CYCLE_S = 0.002


def fed(samples: int, chunk: int, spike_at: int | None = None) -> History:
    history = History(["a", "b"], CYCLE_S)
    t_s = np.arange(samples) * CYCLE_S
    values = np.column_stack([np.sin(t_s), np.full(samples, 3.0)])
    if spike_at is not None:
        values[spike_at, 0] = 50.0
    for at in range(0, samples, chunk):
        history.add(t_s[at : at + chunk], values[at : at + chunk])
    return history


@settings(max_examples=40, deadline=None)
@given(chunk=st.integers(1, 400), spike_at=st.integers(0, 4999), level=st.sampled_from(range(len(LEVELS))))
def test_a_spike_of_one_cycle_is_in_every_view(chunk: int, spike_at: int, level: int) -> None:
    history = fed(5000, chunk, spike_at)
    stretches = history.since(level, 0)
    at = np.searchsorted(stretches.t_s, spike_at * CYCLE_S + 1e-9) - 1
    assert stretches.high[0][at] == 50.0
    assert np.count_nonzero(stretches.high[0] == 50.0) == 1
    assert history.window(0.0, 10.0, 37).high[0].max() == 50.0
    assert np.all(stretches.low[1] == 3.0)


def test_who_asks_again_gets_what_is_new_and_nothing_twice() -> None:
    history, whole = History(["a", "b"], CYCLE_S), fed(3000, 3000).since(0, 0)
    found, number = [], 0
    t_s = np.arange(3000) * CYCLE_S
    for at in range(0, 3000, 77):
        history.add(t_s[at : at + 77], np.column_stack([np.sin(t_s), t_s * 0 + 3.0])[at : at + 77])
        new = history.since(0, number)
        assert new.first == number
        number += len(new)
        found.append(new.low[0])
    assert np.array_equal(np.concatenate(found), whole.low[0])


def test_who_was_away_too_long_gets_what_is_still_there() -> None:
    history = fed(200_000, 5000)
    kept_s = LEVELS[0][1]
    new = history.since(0, 0)
    assert new.first > 0
    assert new.t_s[0] == pytest.approx(200_000 * CYCLE_S - kept_s, abs=0.1)


def test_a_close_look_shows_every_sample() -> None:
    near = fed(5000, 100, 2500).window(4.99, 5.01, 1000)
    assert np.array_equal(near.low, near.high)
    assert np.diff(near.t_s) == pytest.approx(CYCLE_S)
    assert near.t_s[0] <= 4.99
    assert near.t_s[-1] >= 5.01


def test_a_signal_that_is_not_known_for_a_while_leaves_a_gap_and_no_zero() -> None:
    history = History(["a"], CYCLE_S)
    history.add(np.arange(40) * CYCLE_S, np.full((40, 1), np.nan))
    history.add(np.arange(40, 80) * CYCLE_S, np.ones((40, 1)))
    stretches = history.since(0, 0)
    assert np.isnan(stretches.low[0][:4]).all()
    assert (stretches.low[0][4:] == 1.0).all()
    assert history.latest() == {"a": 1.0}


def test_another_run_begins_with_nothing() -> None:
    history = fed(500, 100)
    history.clear()
    assert history.generation == 1
    assert len(history.since(0, 0)) == 0
    assert history.latest() == {"a": None, "b": None}
