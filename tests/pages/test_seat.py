"""Who controls: one of any number of viewers."""

from __future__ import annotations

import pytest

from hilbench.apps.pages.live.controls import IDLE_S, LOST_S, ControlLock


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def control_lock(clock: Clock) -> ControlLock:
    return ControlLock(clock)


def test_one_takes_control_and_others_are_told_who(control_lock: ControlLock) -> None:
    assert control_lock.name == ""
    assert control_lock.take("a", "anna")
    assert not control_lock.take("b", "ben")
    assert (control_lock.name, control_lock.is_of("a"), control_lock.is_of("b")) == ("anna", True, False)


def test_what_is_given_back_another_takes(control_lock: ControlLock) -> None:
    control_lock.take("a", "anna")
    assert not control_lock.give_back("b")
    assert control_lock.give_back("a")
    assert control_lock.left_s is None
    assert control_lock.take("b", "ben")


def test_who_does_nothing_loses_control_and_who_acts_keeps_it(control_lock: ControlLock, clock: Clock) -> None:
    control_lock.take("a", "anna")
    clock.now_s = IDLE_S - 1
    assert control_lock.use("a")
    assert control_lock.left_s == pytest.approx(IDLE_S)
    clock.now_s += IDLE_S + 1
    assert control_lock.name == ""
    assert not control_lock.use("a")


def test_who_only_watches_does_not_keep_another_seated(control_lock: ControlLock, clock: Clock) -> None:
    control_lock.take("a", "anna")
    clock.now_s = IDLE_S - 1
    assert not control_lock.use("b")
    clock.now_s += 2
    assert control_lock.take("b", "ben")


def test_a_connection_that_is_gone_frees_the_seat_unless_it_comes_back_soon(
    control_lock: ControlLock, clock: Clock
) -> None:
    control_lock.take("a", "anna")
    control_lock.leaves("a")
    clock.now_s = LOST_S - 1
    control_lock.comes("a")
    clock.now_s = LOST_S + 5
    assert control_lock.is_of("a")
    control_lock.leaves("b")  # whoever that is
    control_lock.leaves("a")
    clock.now_s += LOST_S + 1
    assert control_lock.name == ""
