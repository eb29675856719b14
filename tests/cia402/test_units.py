"""Device units and the counter that wraps."""

from collections.abc import Callable
from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.cia402.units import DriveUnits, UnwrappingCounter, wrap_int32
from hilbench.errors import UnusableInputError

SERVO: dict[tuple[int, int], int | float] = {
    (0x608F, 1): 2000,
    (0x608F, 2): 1,
    (0x6076, 0): 5000,
    (0x60A9, 0): 0x00B44700,
}


def reader(objects: dict[tuple[int, int], int | float]) -> Callable[[int, int], int | float | None]:
    return lambda index, sub: objects.get((index, sub))


@pytest.mark.parametrize(
    ("code", "rad_s"),
    [
        (0x00B44700, 2 * pi / 60),
        (0xFDB44700, 2 * pi / 60e3),
        (0xFCB44700, 2 * pi / 60e4),
        (0x00B40300, 2 * pi),
        (0xFD100300, 1e-3),
        (0x00B50300, 2 * pi / 2000),
    ],
)
def test_velocity_units(code: int, rad_s: float) -> None:
    units = DriveUnits.from_objects(reader({**SERVO, (0x60A9, 0): code}))
    assert units.velocity_rad_s == pytest.approx(rad_s)


def test_gear_and_feed_constant_lead_to_the_motor_side() -> None:
    geared = {**SERVO, (0x6091, 1): 5, (0x6091, 2): 1, (0x6092, 1): 36000, (0x6092, 2): 1}
    units = DriveUnits.from_objects(reader(geared))
    assert units.position_rad == pytest.approx(5 * 2 * pi / 36000)
    assert units.velocity_rad_s == pytest.approx(5 * 2 * pi / 60)


def test_the_configuration_stands_for_absent_objects() -> None:
    units = DriveUnits.from_objects(reader({}), {"position_rad": 1e-3, "velocity_rad_s": 1e-2, "rated_torque_Nm": 2.0})
    assert units == DriveUnits(1e-3, 1e-2, 0.002)


@pytest.mark.parametrize(
    ("absent", "message"),
    [
        ((0x608F, 1), "608Fh is absent or 0, and so is 6092h"),
        ((0x6076, 0), "6076h is absent"),
        ((0x60A9, 0), "60A9h is absent"),
    ],
)
def test_a_factor_that_nobody_tells_is_named(absent: tuple[int, int], message: str) -> None:
    objects = {key: value for key, value in SERVO.items() if key != absent}
    with pytest.raises(UnusableInputError, match=f"axis 1: {message}"):
        DriveUnits.from_objects(reader(objects), {}, "axis 1")


def test_unknown_velocity_unit_and_unknown_override() -> None:
    with pytest.raises(UnusableInputError, match="00010300h is not one of rpm"):
        DriveUnits.from_objects(reader({**SERVO, (0x60A9, 0): 0x00010300}), {}, "axis 1")
    with pytest.raises(UnusableInputError, match="unknown unit 'velocity'"):
        DriveUnits.from_objects(reader(SERVO), {"velocity": 1.0}, "axis 1")


@given(st.integers(-(2**31), 2**31 - 1), st.lists(st.integers(-(2**31) + 1, 2**31 - 1), max_size=30))
def test_unwrapping_undoes_wrapping(start: int, steps: list[int]) -> None:
    counter = UnwrappingCounter()
    value = start
    assert counter.update(wrap_int32(value)) == value
    for step in steps:
        value += step
        assert counter.update(wrap_int32(value)) == value
