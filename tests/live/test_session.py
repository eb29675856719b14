"""What is said of a gap that comes and goes, on rows alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilbench.bench.reports.diagnosis_updates import CHUNK_CYCLES, DiagnosisUpdate, Samples
from hilbench.live.session import Session
from hilbench.live.web_line import LiveLine
from hilbench.runs.config import load_with_overrides
from hilbench.topology.blocks import LiveDiagnosisConfig

CONFIG = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "live_friction.yaml").config
MODEL, CYCLE_S = CONFIG.web_line, CONFIG.cycle_time_s
SPEED_M_S, TORQUE_NOISE_Nm, MORE_Nm = 3.0, 0.05, 0.2


def told(end_s: float, *more_s: tuple[float, float]) -> list[DiagnosisUpdate]:
    """Of a line that runs at one speed, with more torque at axis 2 in these times."""
    count = round(end_s / CYCLE_S)
    t_s, noise = np.arange(count) * CYCLE_S, np.random.default_rng(2)
    boundary, x_m = MODEL.boundary, SPEED_M_S * np.arange(count) * CYCLE_S
    pull_Nm = (boundary.upstream_tension_N - boundary.downstream_tension_N) / MODEL.motor_rad_per_m(2)
    more = sum((t_s >= begun_s) & (t_s < over_s) for begun_s, over_s in more_s)
    channels = {"t_s": t_s, "x1_m": x_m, "x2_m": x_m}
    channels |= {name: np.full(count, SPEED_M_S) for name in ("v1_m_s", "v2_m_s", "v1_cmd_m_s", "v2_cmd_m_s")}
    channels["tau1_Nm"] = TORQUE_NOISE_Nm * noise.standard_normal(count)
    channels["tau2_Nm"] = pull_Nm + MORE_Nm * more + TORQUE_NOISE_Nm * noise.standard_normal(count)
    channels["strain_prev"] = np.full(count, MODEL.upstream_strain)
    channels["F_next_N"] = np.full(count, boundary.downstream_tension_N)
    channels["F_sim_N"] = np.full(count, boundary.upstream_tension_N)
    channels["E_sim_Pa"] = np.full(count, MODEL.youngs_modulus_Pa(1))
    session = Session(list(channels), LiveLine(MODEL, None, CYCLE_S), LiveDiagnosisConfig(), CYCLE_S)
    news: list[DiagnosisUpdate] = []
    for end in range(CHUNK_CYCLES, count + 1, CHUNK_CYCLES):
        chunk = np.column_stack([values[end - CHUNK_CYCLES : end] for values in channels.values()])
        news += session.samples(Samples.of(end - 1, chunk)).news
    return news


def test_a_gap_that_has_passed_by_itself_is_not_searched_for_in_what_came_after_it() -> None:
    news = told(22.0, (6.0, 7.5))
    assert [each.what for each in news] == ["seen", "ended"]
    assert "passed by itself" in news[1].text


def test_what_comes_after_a_gap_that_has_passed_is_looked_into_from_when_it_came() -> None:
    first, again = told(14.5, (6.0, 7.5), (10.0, 20.0))
    assert (first.what, again.what) == ("seen", "seen")
    assert abs(again.begun_cycle * CYCLE_S - 10.0) <= CHUNK_CYCLES * CYCLE_S
