"""A line that runs backwards for many lengths of its spans: tension and E are kept as they are forward."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hilbench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.recording import Recording

CONFIGS = Path(__file__).parents[2] / "bench_configs"
OLD_PA, NEW_PA = 8.7e9, 10.5e9


def off_pct(recording: Recording, span: str = "") -> NDArray[np.float64]:
    """By how much the twin's E is wrong."""
    found, true = (np.asarray(recording[f"E{span}_{kind}_Pa"]) for kind in ("sim", "true"))
    return np.asarray(100.0 * np.abs(found / true - 1.0))


def off_N(recording: Recording, span: str = "") -> NDArray[np.float64]:
    """By how much the true tension is not the set-point."""
    return np.asarray(np.abs(np.asarray(recording[f"F{span}_true_N"]) - np.asarray(recording[f"F{span}_ref_N"])))


def test_after_forty_lengths_of_the_span_in_reverse_a_step_of_E_is_found_and_the_tension_stays() -> None:
    with Bench(CONFIGS / "web_section_step.yaml", participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", -3.0, duration_s=1.5)
        bench.run(13.0)
        at_s = bench.time_s
        bench.step("load.web.youngs_modulus_Pa", NEW_PA)
        bench.run(1.5)
        bench.ramp("line_speed_m_s", 2.0, duration_s=2.0)
        bench.run(1.0)
    t, E_pct, F_N = bench.recording.time_s, off_pct(bench.recording), off_N(bench.recording)
    assert np.all(F_N[(t > 3.0) & (t < at_s)] < 0.5)
    assert np.all(E_pct[t > at_s + 0.3] < 1.0)
    assert np.all(F_N[t > at_s + 1.0] < 1.0)  # through standstill too


@pytest.mark.slow
def test_in_reverse_the_spans_of_a_line_get_the_web_of_the_span_behind() -> None:
    """At 2 m/s, 10 lengths of the three spans; as `line_three_spans.yaml` asks of it forward."""
    steps_s = {}
    with Bench(CONFIGS / "line_three_spans.yaml", participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", -2.0, duration_s=3.0)
        bench.run(25.0)
        for span in ("1", "2", "3"):
            steps_s[span] = bench.time_s
            bench.step(f"load.web.span{span}.youngs_modulus_Pa", 1.2 * OLD_PA)
            bench.run(6.0)
        set_s = bench.time_s
        bench.step("tension_control.span2.set_point_N", 95.0)
        bench.run(6.0)
    recording, t = bench.recording, bench.recording.time_s
    for span, at_s in steps_s.items():
        E_pct, F_N = off_pct(recording, span), off_N(recording, span)
        assert np.all(E_pct[(t > at_s + 0.3) | ((t > 8.0) & (t < at_s))] < 1.0)
        assert np.all(F_N[(t > at_s + 1.5) & (t < at_s + 6.0)] < 1.0)
    for span in ("1", "3"):
        assert np.all(off_N(recording, span)[t > set_s] < 1.0)
