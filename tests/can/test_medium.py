"""The wire: arbitration order, bus time, disturbances."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.can.confinement import ControllerState
from hilbench.can.disturbance import Disturber, ErrorInjection
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, accepts, priority
from hilbench.can.medium import FOREVER, Medium, Station
from hilbench.can.wire import ERROR_FRAME_BITS


def on_the_wire(can_id: int) -> str:
    """Arbitration field and IDE bit as they are sent, written out."""
    remote = "1" if can_id & REMOTE_FLAG else "0"
    if can_id & EXTENDED_FLAG:
        identifier = format(can_id & 0x1FFFFFFF, "029b")
        return identifier[:11] + "11" + identifier[11:] + remote
    return format(can_id & 0x7FF, "011b") + remote + "0"


def wins(first: int, second: int) -> bool:
    """Whether `first` keeps the bus: at the first different bit it sends the dominant one."""
    for one, other in zip(on_the_wire(first), on_the_wire(second), strict=False):
        if one != other:
            return one == "0"
    raise AssertionError("no two of these look alike")


ids = st.tuples(
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF).map(lambda i: i | EXTENDED_FLAG) | st.sampled_from([0x123]),
    st.booleans(),
).map(lambda pair: pair[0] | REMOTE_FLAG if pair[1] else pair[0])


@given(ids, ids)
def test_priority_is_bitwise_arbitration(first: int, second: int) -> None:
    if first != second:
        assert (priority(first) < priority(second)) is wins(first, second)


@given(st.integers(0, 0x7FF), st.integers(0, 0x3FFFF))
def test_base_data_base_remote_extended_data_extended_remote(base: int, extension: int) -> None:
    extended = EXTENDED_FLAG | base << 18 | extension
    ladder = [base, base | REMOTE_FLAG, extended, extended | REMOTE_FLAG]
    assert sorted([ladder[n] for n in (2, 0, 3, 1)], key=priority) == ladder


def medium_with(count: int, bitrate: int = 1_000_000) -> tuple[Medium, list[Station]]:
    medium = Medium(bitrate)
    stations = [Station() for _ in range(count)]
    for station in stations:
        medium.join(station)
    return medium, stations


@given(st.lists(st.lists(st.integers(0, 0x7FF), max_size=6), min_size=1, max_size=4))
def test_heads_compete_and_each_sender_keeps_its_order(queues: list[list[int]]) -> None:
    medium, stations = medium_with(len(queues))
    for station, queue in zip(stations, queues, strict=True):
        for can_id in queue:
            medium.queue(station, can_id, None, 100, 0)
    sent = medium.run(FOREVER)
    waiting = [list(queue) for queue in queues]
    for delivery in sent:
        heads = [queue[0] for queue in waiting if queue]
        assert delivery.can_id == min(heads)
        assert waiting[stations.index(delivery.sender)].pop(0) == delivery.can_id
    assert not any(waiting)
    assert [delivery.time_ns for delivery in sent] == [100_000 * n for n in range(1, len(sent) + 1)]


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    medium, (first, second) = medium_with(2)
    medium.queue(first, 0x700, None, 100, 0)
    assert medium.run(50_000) == []
    medium.queue(first, 0x701, None, 100, 50_000)
    medium.queue(second, 0x001, None, 100, 50_000)
    assert [delivery.can_id for delivery in medium.run(FOREVER)] == [0x700, 0x001, 0x701]


def test_bus_time_follows_the_bits_after_a_late_look() -> None:
    """Who looks late finds the frames over at their own times, back to back."""
    medium, (station,) = medium_with(1, bitrate=500_000)
    for n in range(3):
        medium.queue(station, n, None, 111, 1_000)
    assert medium.next_event_ns() == 1_000
    assert [d.time_ns for d in medium.run(600_000)] == [223_000, 445_000]
    assert medium.next_event_ns() == 667_000
    assert [d.time_ns for d in medium.run(667_000)] == [667_000]
    assert medium.next_event_ns() is None


def test_a_frame_that_came_after_the_wire_was_free_did_not_compete() -> None:
    medium, (first, second) = medium_with(2)
    medium.queue(first, 0x700, None, 100, 0)
    medium.queue(second, 0x001, None, 100, 1)
    assert [delivery.can_id for delivery in medium.run(FOREVER)] == [0x700, 0x001]


def test_a_frame_begins_no_sooner_than_it_is_there() -> None:
    """Looking at the wire before a frame is there commits nothing: what comes in between competes."""
    medium, (first, second) = medium_with(2)
    medium.queue(first, 0x700, None, 100, 1_000)
    assert medium.run(500) == []
    medium.queue(second, 0x001, None, 100, 900)
    assert [delivery.can_id for delivery in medium.run(FOREVER)] == [0x001, 0x700]


def run_disturbed(injection: ErrorInjection, count: int = 200) -> tuple[list[int], Medium]:
    medium, (station,) = medium_with(1)
    medium.disturber = Disturber(injection)
    for n in range(count):
        medium.queue(station, 0x100, n, 100, 0)
    return [delivery.payload for delivery in medium.run(FOREVER)], medium


def test_lost_frames_take_their_time_and_arrive_nowhere() -> None:
    arrived, medium = run_disturbed(ErrorInjection(seed=1, lost=0.2))
    assert 10 < medium.counters.lost < 90
    assert len(arrived) == 200 - medium.counters.lost
    assert arrived == sorted(arrived)
    assert medium.free_ns == 200 * 100_000


def test_corrupted_frames_arrive_after_another_attempt() -> None:
    arrived, medium = run_disturbed(ErrorInjection(seed=1, corrupted=0.2))
    errors = medium.counters.error_frames
    assert arrived == list(range(200))
    assert 10 < errors < 110
    wasted = medium.counters.bits - 200 * 100
    assert errors * (ERROR_FRAME_BITS + 1) <= wasted <= errors * (ERROR_FRAME_BITS + 97)
    assert medium.free_ns == medium.counters.bits * 1000


def test_a_corrupted_frame_competes_again() -> None:
    medium, (first, second) = medium_with(2)
    medium.disturber = Disturber(ErrorInjection(corrupted=0.9, seed=3, filters=((0x700, 0x7FF),)))
    medium.queue(first, 0x700, None, 100, 0)
    medium.run(0)
    medium.queue(second, 0x001, None, 100, 0)
    assert [delivery.can_id for delivery in medium.run(FOREVER)] == [0x001, 0x700]


def test_a_station_whose_frames_never_succeed_is_bus_off() -> None:
    """ISO 11898-1: 8 for each failed attempt, passive from 128, off from 256; what was queued is lost."""
    medium, (station, other) = medium_with(2)
    medium.disturber = Disturber(ErrorInjection(corrupted=1.0, filters=((0x100, 0x7FF),)))
    for _ in range(3):
        medium.queue(station, 0x100, None, 100, 0)
    states = []
    while medium.next_event_ns() is not None:
        medium.run(medium.next_event_ns() or 0)
        states += [(each is station, each.state, each.errors.transmit) for each in medium.changed]
        medium.changed.clear()
    assert states == [(True, ControllerState.ERROR_PASSIVE, 128), (True, ControllerState.BUS_OFF, 256)]
    assert (medium.counters.error_frames, medium.counters.lost) == (32, 3)
    assert other.errors.receive == 32
    medium.queue(station, 0x200, None, 100, 0)
    medium.queue(other, 0x300, None, 100, 0)
    assert [delivery.can_id for delivery in medium.run(FOREVER)] == [0x300]
    assert medium.counters.lost == 4


def test_error_counters_fall_with_every_good_frame() -> None:
    medium, (station, other) = medium_with(2)
    medium.disturber = Disturber(ErrorInjection(corrupted=0.97, seed=2, filters=((0x100, 0x7FF),)))
    medium.queue(station, 0x100, None, 100, 0)
    medium.run(FOREVER)
    before = medium.counters.error_frames
    assert 1 < before < 32
    assert (station.errors.transmit, other.errors.receive) == (8 * before - 1, before - 1)
    for _ in range(300):
        medium.queue(station, 0x200, None, 100, 0)
    medium.run(FOREVER)
    assert station.errors.clear
    assert other.errors.clear
    assert station.state is ControllerState.ERROR_ACTIVE


def test_duplicated_frames_arrive_twice_in_a_row() -> None:
    arrived, medium = run_disturbed(ErrorInjection(seed=1, duplicated=0.2))
    assert [key for key, _ in itertools.groupby(arrived)] == list(range(200))
    assert 210 < len(arrived) < 290
    assert medium.free_ns == len(arrived) * 100_000


def test_a_delayed_frame_holds_its_sender_only() -> None:
    medium, (first, second) = medium_with(2)
    medium.disturber = Disturber(ErrorInjection(delayed=1.0, delay_s=0.01, filters=((0x100, 0x7FF),)))
    for station, can_id in ((first, 0x100), (first, 0x080), (second, 0x700), (second, 0x701)):
        medium.queue(station, can_id, None, 100, 0)
    sent = [(delivery.can_id, delivery.time_ns) for delivery in medium.run(FOREVER)]
    assert sent == [(0x700, 100_000), (0x701, 200_000), (0x100, 10_100_000), (0x080, 10_200_000)]


def test_the_draws_do_not_depend_on_how_senders_interleave() -> None:
    injection = ErrorInjection(seed=7, lost=0.3, duplicated=0.3)
    one, other = Disturber(injection), Disturber(injection)
    alternating = [(can_id, one.draw(can_id, 100)) for _ in range(40) for can_id in (1, 2)]
    grouped = [(can_id, other.draw(can_id, 100)) for can_id in (1, 2) for _ in range(40)]
    assert sorted(alternating, key=lambda pair: pair[0]) == grouped
    first, second = [[fate for can_id, fate in grouped if can_id == which] for which in (1, 2)]
    assert first != second
    assert run_disturbed(injection)[0] != run_disturbed(ErrorInjection(seed=8, lost=0.3, duplicated=0.3))[0]


@pytest.mark.parametrize("wrong", [{"lost": 1.1}, {"corrupted": -0.1}, {"delay_s": -1.0}, {"lost": float("nan")}])
def test_impossible_disturbances_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ErrorInjection(**wrong)  # type: ignore[arg-type]


def test_filters_accept_as_the_kernel_does() -> None:
    assert accepts(None, 0x123)
    assert not accepts([], 0x123)
    assert accepts([(0x700, 0x7FF), (0x120, 0x7F0)], 0x12F)
    assert not accepts([(0x123, 0x7FF | EXTENDED_FLAG)], 0x123 | EXTENDED_FLAG)
