"""A line beside copies of it in which one unknown each is a little other."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.twin.beside_stations import dancer_line, guided_line, winding_line

from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sensitivity_model import SensitivityModel

CYCLE_S = 0.003
LINES = {"dancer": dancer_line, "idlers": guided_line, "reels": winding_line}


@pytest.mark.parametrize("model", LINES.values(), ids=LINES.keys())
@pytest.mark.parametrize("speed_m_s", [0.0, 2.0, -2.0])
def test_a_line_that_starts_under_way_has_the_tensions_of_its_strains_at_once(
    model: Callable[[], ModelParameters], speed_m_s: float
) -> None:
    """Its web damps swings, and nothing swings: all rollers go as fast as the web."""
    parameters = model()
    varied = SensitivityModel(parameters)
    positions_m = [40.0 + axis for axis in range(parameters.axis_count)]
    varied.reset(positions_m, speed_m_s)
    strained_N = [parameters.stiffness_N(span) * float(e) for span, e in enumerate(varied.line.strain, 1)]
    assert varied.line.tension_N == pytest.approx(strained_N, abs=0.1)
    # Equally strained everywhere and at that speed, it goes on so.
    ratios = varied.ratios.tolist()
    moved = [x + speed_m_s * CYCLE_S / ratio for x, ratio in zip(positions_m, ratios, strict=True)]
    varied.copies.follow(moved, CYCLE_S)
    assert varied.line.tension_N == pytest.approx(strained_N, rel=0.02)
