"""Heartbeat cases of the conformance test, and those of heartbeat beside node guarding, which the drive lacks."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

REMOTE = 0x40000000
START, RESET_NODE = 1, 129
PRE_OPERATIONAL, OPERATIONAL = (0x705, "7f"), (0x705, "05")
CONSUMERS = (1, 2, 3, 4)


def each_ms(drive: DriveUnderTest, duration_ms: int) -> list[tuple[int, str]]:
    """What the drive says while time passes, looked at each ms."""
    return [frame for _ in range(duration_ms) for frame in drive.after(1)]


def produce(drive: DriveUnderTest, period_ms: int) -> None:
    low, high = period_ms.to_bytes(2, "little")
    assert drive.sdo(f"2b 17 10 00 {low:02x}{high:02x}0000") == "6017100000000000"


def watch(drive: DriveUnderTest, entry: int, node: int, time_ms: int) -> None:
    value = (node << 16 | time_ms).to_bytes(4, "little").hex()
    assert drive.sdo(f"23 16 10 {entry:02x} {value}") == f"601610{entry:02x}00000000"


@case("Heartbeat 1")
def test_period_is_written(drive: DriveUnderTest) -> None:
    assert drive.sdo("2b 17 10 00 64000000") == "6017100000000000"
    assert drive.sdo("40 17 10 00 00000000") == "4b17100064000000"


@case("Heartbeat 2")
def test_count_of_heartbeats(drive: DriveUnderTest) -> None:
    produce(drive, 100)
    assert each_ms(drive, 10_000) == [PRE_OPERATIONAL] * 100


@case("Heartbeat 3")
def test_heartbeat_is_disabled(drive: DriveUnderTest) -> None:
    produce(drive, 100)
    assert each_ms(drive, 100) == [PRE_OPERATIONAL]
    produce(drive, 0)
    assert each_ms(drive, 10_000) == []


@case("Heartbeat 4")
def test_a_node_is_watched_by_one_entry_only(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 16 10 01 34120500") == "6016100100000000"
    assert drive.sdo("23 16 10 02 34120500") == "8016100243000406"
    assert drive.sdo("40 16 10 02 00000000") == "4316100200000000"
    assert drive.sdo("23 16 10 01 35120500") == "6016100100000000"


@case("Heartbeat 5")
@pytest.mark.parametrize("entry", CONSUMERS)
def test_consumer_hears_in_time(drive: DriveUnderTest, entry: int) -> None:
    watch(drive, entry, entry + 1, 1000)
    drive.nmt(START)
    each_ms(drive, 1)
    for _ in range(10):
        assert drive.send(0x701 + entry, "7f") == []
        assert each_ms(drive, 900) == []
    produce(drive, 1)
    assert each_ms(drive, 1) == [OPERATIONAL]


@case("Heartbeat 6")
@pytest.mark.parametrize("entry", CONSUMERS)
def test_consumer_misses_a_heartbeat(drive: DriveUnderTest, entry: int) -> None:
    node = entry + 1
    watch(drive, entry, node, 1000)
    drive.nmt(START)
    each_ms(drive, 1)
    assert drive.send(0x700 + node, "7f") == []
    assert each_ms(drive, 1500) == [(0x085, f"308111{node:02x}00000000")]
    assert drive.send(0x700 + node, "7f") == [(0x085, "0000003081000000")]
    produce(drive, 1)
    assert each_ms(drive, 1) == [PRE_OPERATIONAL]  # 1029h


@case("Heartbeat 6")
def test_error_goes_when_the_node_is_watched_no_more(drive: DriveUnderTest) -> None:
    watch(drive, 1, 7, 1000)
    drive.send(0x707, "7f")
    assert each_ms(drive, 1500) == [(0x085, "3081110700000000")]
    frames = drive.send(0x605, "2316100100000000")
    assert frames == [(0x585, "6016100100000000"), (0x085, "0000003081000000")]
    assert drive.sdo("40 01 10 00 00000000") == "4f01100000000000"


@case("Heartbeat 7")
def test_reset_ends_the_watch(drive: DriveUnderTest) -> None:
    watch(drive, 1, 0x47, 1000)
    drive.nmt(START)
    each_ms(drive, 1)
    assert each_ms(drive, 10_000) == []  # the time begins with the first heartbeat
    drive.send(0x747, "7f")
    assert each_ms(drive, 1001) == [(0x085, "3081114700000000")]
    assert drive.nmt(RESET_NODE) == [(0x705, "00")]
    assert drive.sdo("40 16 10 01 00000000") == "4316100100000000"
    assert drive.sdo("40 01 10 00 00000000") == "4f01100000000000"
    drive.send(0x747, "7f")
    assert each_ms(drive, 10_000) == []


@case("Heartbeat 7")
def test_node_that_was_heard_before_a_reset_is_not_missed_after_it(drive: DriveUnderTest) -> None:
    watch(drive, 1, 0x47, 1000)
    assert drive.sdo("23 10 10 01 73617665") == "6010100100000000"
    drive.send(0x747, "7f")
    drive.nmt(RESET_NODE)
    assert drive.sdo("40 16 10 01 00000000") == "43161001e8034700"
    assert each_ms(drive, 10_000) == []
    drive.send(0x747, "7f")
    assert each_ms(drive, 10_000) == [(0x085, "3081114700000000")]


# -- beside node guarding --------------------------------------------------------------------------------


@case("Heartbeat and guarding 1")
def test_heartbeat_is_there_and_guarding_is_not(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 17 10 00 00000000") == "4b17100000000000"
    assert drive.sdo("40 0c 10 00 00000000") == "800c100000000206"
    assert drive.sdo("40 0d 10 00 00000000") == "800d100000000206"


@case("Heartbeat and guarding 2")
def test_switched_off_heartbeat(drive: DriveUnderTest) -> None:
    produce(drive, 500)
    produce(drive, 0)
    assert each_ms(drive, 2000) == []


@case("Heartbeat and guarding 4")
def test_heartbeat_alone(drive: DriveUnderTest) -> None:
    produce(drive, 500)
    assert each_ms(drive, 2000) == [PRE_OPERATIONAL] * 4


@case("Heartbeat and guarding 5")
def test_remote_requests_do_not_disturb_the_heartbeat(drive: DriveUnderTest) -> None:
    produce(drive, 500)
    for _ in range(4):
        assert each_ms(drive, 250) == []
        assert drive.send(REMOTE | 0x705, b"\0") == []
        assert each_ms(drive, 250) == [PRE_OPERATIONAL]
