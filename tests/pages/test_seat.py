"""Who controls: one of any number of viewers."""

from __future__ import annotations

import pytest

from hilbench.pages.live.seat import GONE_S, IDLE_S, Seat


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def seat(clock: Clock) -> Seat:
    return Seat(clock)


def test_one_takes_control_and_others_are_told_who(seat: Seat) -> None:
    assert seat.name == ""
    assert seat.take("a", "anna")
    assert not seat.take("b", "ben")
    assert (seat.name, seat.is_of("a"), seat.is_of("b")) == ("anna", True, False)


def test_what_is_given_back_another_takes(seat: Seat) -> None:
    seat.take("a", "anna")
    assert not seat.give_back("b")
    assert seat.give_back("a")
    assert seat.left_s is None
    assert seat.take("b", "ben")


def test_who_does_nothing_loses_control_and_who_acts_keeps_it(seat: Seat, clock: Clock) -> None:
    seat.take("a", "anna")
    clock.now_s = IDLE_S - 1
    assert seat.use("a")
    assert seat.left_s == pytest.approx(IDLE_S)
    clock.now_s += IDLE_S + 1
    assert seat.name == ""
    assert not seat.use("a")


def test_who_only_watches_does_not_keep_another_seated(seat: Seat, clock: Clock) -> None:
    seat.take("a", "anna")
    clock.now_s = IDLE_S - 1
    assert not seat.use("b")
    clock.now_s += 2
    assert seat.take("b", "ben")


def test_a_connection_that_is_gone_frees_the_seat_unless_it_comes_back_soon(seat: Seat, clock: Clock) -> None:
    seat.take("a", "anna")
    seat.leaves("a")
    clock.now_s = GONE_S - 1
    seat.comes("a")
    clock.now_s = GONE_S + 5
    assert seat.is_of("a")
    seat.leaves("b")  # whoever that is
    seat.leaves("a")
    clock.now_s += GONE_S + 1
    assert seat.name == ""
