"""Slip in a section with a carriage, told from a web that changes its E: web lengths as mass conservation has them."""

from __future__ import annotations

from math import inf

import pytest

from hilbench.estimation.web_line.carriage_slip import CarriageSlip

LENGTH_M, STRAIN, SPEED_M_S, CYCLE_S = 8.0, 8e-4, 1.2, 0.024


def fed(change: float, slip: float) -> CarriageSlip:
    """The detector after two lengths of web, the second one with E changed, or with a slip at its first roller."""
    detector, passed_m = CarriageSlip(LENGTH_M, 4, STRAIN), SPEED_M_S * CYCLE_S
    for cycle in range(round(2.0 * LENGTH_M / passed_m)):
        changes = cycle == round(LENGTH_M / passed_m)
        # The carriage keeps the tension: all of the section's web is longer, or shorter, at once.
        room_m = STRAIN * LENGTH_M * (1.0 / (1.0 + change) - 1.0) if changes else 0.0
        slips_m = slip * passed_m if cycle * passed_m > LENGTH_M else 0.0
        detector.take(cycle * CYCLE_S, passed_m + slips_m, passed_m, room_m)
    return detector


@pytest.mark.parametrize("change", [-0.4, -0.15, 0.15, 0.4])
def test_an_e_that_steps_is_no_slip(change: float) -> None:
    assert fed(change, 0.0).since_s == inf


@pytest.mark.parametrize("slip", [-0.05, 0.05])
def test_a_roller_that_slips_is_found(slip: float) -> None:
    assert fed(0.0, slip).since_s < inf
