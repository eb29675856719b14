"""A TPDO that comes every few SYNCs: which of its frames are answers, and which nobody asked for."""

from __future__ import annotations

from collections.abc import Iterable

import pytest

from hilbench.exchange.answers import Tpdo

EVERY = 5


def followed(cycles: Iterable[int], length: int = 100) -> tuple[list[int], list[int]]:
    """The cycles in which a frame was used, and those in which one was that nobody was owed; `cycles`: in which one
    each comes (one that stands there twice: two frames)."""
    tpdo = Tpdo(0x282, 2, EVERY, "virtual I/O")
    used, surplus = [], []
    come = list(cycles)
    for cycle in range(length):
        tpdo.begin()
        for place in range(come.count(cycle)):
            tpdo.add(bytes([cycle % 256, place]), before_sync=False)
        tpdo.end(0)
        if tpdo.data is not None:
            used.append(cycle)
        if tpdo.surplus:
            surplus.append(cycle)
    return used, surplus


def test_all_that_come_in_time_are_used() -> None:
    come = range(0, 100, EVERY)
    assert followed(come) == (list(come), [])


@pytest.mark.parametrize("late", [1, 2, 3, 4, 5])
def test_one_that_is_late_takes_nothing_from_the_next(late: int) -> None:
    come = [cycle + (late if cycle == 50 else 0) for cycle in range(0, 100, EVERY)]
    used, surplus = followed(come)
    assert used == sorted(set(come))
    assert surplus == []


def test_what_was_held_up_for_long_may_come_at_once() -> None:
    come = [*range(0, 50, EVERY), *[67] * 4, *range(70, 100, EVERY)]
    used, surplus = followed(come)
    assert used == sorted(set(come))
    assert surplus == []


def test_a_second_sender_is_told_also_behind_answers_that_were_late() -> None:
    come = [cycle + (3 if cycle == 20 else 0) for cycle in range(0, 1000, EVERY)]
    others = range(602, 1000, EVERY)
    _, surplus = followed([*come, *others], 1000)
    assert min(surplus) >= 602
    assert len(surplus) >= len(others) - 2
