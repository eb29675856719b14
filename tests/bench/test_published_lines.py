"""Published lines as benches: what their papers do, within what is asked of them."""

from __future__ import annotations

import numpy as np
import pytest
from tests.bench.whole_runs import Shipped

from hilbench.results.recording import read_recording
from hilbench.results.run import RunOutcome


def passed(outcome: RunOutcome, criteria: int) -> RunOutcome:
    """A shipped config has run without a fault, and all its criteria hold."""
    assert outcome.result.faults == []
    assert [row.verdict for row in outcome.result.criteria] == ["passed"] * criteria
    return outcome


@pytest.mark.slow
def test_Giannoccaros_tensions_stay_within_3_percent_as_the_speed_doubles(shipped: Shipped) -> None:
    result = passed(shipped("giannoccaro_2016"), criteria=3).result
    assert max(row.value or 0.0 for row in result.criteria) < 0.03 * 14.0


@pytest.mark.slow
def test_Kocs_tensions_stay_within_2_percent_as_the_speed_changes_and_its_twin_finds_E(shipped: Shipped) -> None:
    outcome = passed(shipped("koc_2002"), criteria=2)
    assert max(row.value or 1.0 for row in outcome.result.criteria) < 0.02 * 15.0
    found = read_recording(outcome.folder.recording)
    running = np.asarray(found["t_s"]) > 3.0
    for span in (1, 4):
        error = np.asarray(found[f"E{span}_sim_Pa"]) / np.asarray(found[f"E{span}_true_Pa"]) - 1.0
        assert np.max(np.abs(error[running])) < 0.02


@pytest.mark.slow
def test_both_ends_of_Kuhms_accumulator_stay_within_3_percent_of_a_reel_change(shipped: Shipped) -> None:
    outcome = passed(shipped("kuhm_2012"), criteria=3)
    assert max(row.value or 100.0 for row in outcome.result.criteria) < 3.0
    found = read_recording(outcome.folder.recording)
    time_s = np.asarray(found["t_s"])
    assert np.min(np.asarray(found["v1_m_s"])[time_s > 12.0]) < 0.01
    # Of 4.2 m/s what did not come in while the infeed stopped, stood and started again, over 18 strands.
    assert np.ptp(np.asarray(found["x_store_true_m"])[time_s > 12.0]) == pytest.approx(4.2 * 8.0 / 18.0, rel=0.02)
    # What 17 rollers of 0.01/0.075² kg need between the ends, forward and back, no force on the carriage can change.
    ends_N = (np.asarray(found["F1_true_N"]) - np.asarray(found["F18_true_N"]))[(time_s > 12.0) & (time_s < 26.0)]
    assert np.ptp(ends_N) > 2.0 * 17.0 * 0.01 / 0.075**2 * 0.5 * 4.2 / 6.5 * 9.0 / 7.0
