"""What is lasting in how far predictions were off."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.bench.prediction.window import Hindsight
from hilbench.prediction.outlook import Outlook, WatchedQuantity

TORQUE = np.array([0])


def outlook(now_s: float, course_Nm: np.ndarray, row_s: float = 0.05) -> Outlook:
    """16 futures of one torque that all go one way, a row every `row_s`."""
    times_s = now_s + row_s * np.arange(1, len(course_Nm) + 1)
    rows = np.repeat(course_Nm[:, None, None], 16, axis=1)
    return Outlook(
        now_s,
        [WatchedQuantity("torque", "tau1_Nm", "N·m")],
        times_s,
        rows,
        rows[0],
        np.zeros((1, 2)),
        np.full((16, 1, 2), np.nan),
        np.zeros(1),
    )


def looked(off_Nm: float, *, late_s: float = 0.0, every_s: float = 0.1, seconds: float = 4.0) -> Hindsight:
    """Looks ahead at a torque of 3 N·m that ends at 2 s; what comes is `off_Nm` more, and `late_s` late."""
    hindsight = Hindsight(1)
    for now_s in np.arange(0.0, seconds, every_s):
        came = (3.0 if now_s < 2.0 + late_s else 0.0) + off_Nm
        hindsight.compare(float(now_s), np.array([came]), TORQUE)
        times_s = now_s + 0.05 * np.arange(1, 101)
        hindsight.expect(outlook(float(now_s), np.where(times_s < 2.0, 3.0, 0.0) + hindsight.lasting[0]))
    return hindsight


@pytest.mark.parametrize("every_s", [0.1, 0.3, 1.0])
def test_what_all_predictions_are_off_by_is_lasting(every_s: float) -> None:
    hindsight = looked(0.2, every_s=every_s, seconds=20.0)
    assert hindsight.lasting[0] == pytest.approx(0.2, abs=0.02)
    assert hindsight.deviation[0] < 0.05


@pytest.mark.parametrize("late_s", [-0.05, 0.0, 0.08])
def test_a_ramp_that_ends_a_little_early_or_late_is_nothing_lasting(late_s: float) -> None:
    hindsight = looked(0.0, late_s=late_s)
    assert hindsight.lasting[0] == 0.0
    assert hindsight.deviation[0] == 0.0


def test_a_ramp_that_ends_half_a_second_late_was_predicted_wrongly() -> None:
    assert looked(0.0, late_s=0.5, seconds=2.5).lasting[0] > 0.3


def test_what_the_outlooks_do_not_reach_is_not_compared() -> None:
    hindsight = Hindsight(1)
    hindsight.expect(outlook(0.0, np.full(4, 1.0)))
    hindsight.compare(0.6, np.array([5.0]), TORQUE)
    assert hindsight.lasting[0] == 0.0
