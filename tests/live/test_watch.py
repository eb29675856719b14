"""Noise of a line whose model is right is no gap, from the first half second on; nor is web of unknown strain."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hilbench.live.watch import Watch
from hilbench.live.web_line import LiveLine
from hilbench.runs.config import load_with_overrides

CONFIG = load_with_overrides(Path(__file__).resolve().parents[2] / "bench_configs" / "live_friction.yaml").config
MODEL, CYCLE_S, CHUNK = CONFIG.web_line, CONFIG.cycle_time_s, 250
TORQUE_NOISE_Nm, SPEED_M_S, CHUNKS, STANDS = 0.05, 1.0, 16, 10


def most_in_a_row(seed: int, tighter_N: float = 0.0) -> int:
    """Pieces that part, of a line that runs at one speed as its model does; its web was that much tighter than the
    model's when the watch began."""
    one = Watch(LiveLine(MODEL, None, CYCLE_S), MODEL)
    noise, most = np.random.default_rng(seed), 0
    pulls_N = (0.0, MODEL.boundary.upstream_tension_N - MODEL.boundary.downstream_tension_N)
    for chunk in range(CHUNKS):
        x_m = SPEED_M_S * CYCLE_S * np.arange(chunk * CHUNK, (chunk + 1) * CHUNK)
        channels = {"strain_prev": np.full(CHUNK, MODEL.upstream_strain)}
        channels["F_next_N"] = np.full(CHUNK, MODEL.boundary.downstream_tension_N)
        gone = tighter_N * np.exp(-x_m / MODEL.span_length_m(1))  # axis 1 has to pull less by so much, axis 2 more
        for k, pull_N in enumerate((pulls_N[0] - gone, pulls_N[1] + gone), 1):
            channels |= {f"x{k}_m": x_m, f"v{k}_m_s": np.full(CHUNK, SPEED_M_S)}
            channels[f"tau{k}_Nm"] = pull_N / MODEL.motor_rad_per_m(k) + TORQUE_NOISE_Nm * noise.standard_normal(CHUNK)
        one.update((chunk + 1) * CHUNK - 1, channels, np.ones(CHUNK, bool))
        most = max(most, one.in_a_row)
    return most


def test_a_stand_whose_first_half_second_is_quiet_by_chance_has_no_gap() -> None:
    assert [most_in_a_row(seed) for seed in range(STANDS)] == [0] * STANDS


def test_web_whose_strain_nobody_knows_is_no_gap_before_it_has_left() -> None:
    assert most_in_a_row(0, tighter_N=10.0) == 0
