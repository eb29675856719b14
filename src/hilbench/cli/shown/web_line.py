"""A web line."""

from __future__ import annotations

from typing import Final

from hilbench.cli.shown.machine import LiveRow, Shown

SHOWN: Final = Shown(
    live=(
        LiveRow("line speed", ("v2_m_s",), "m/s", ".3f"),
        LiveRow("tension true / simulated / set-point", ("F_true_N", "F_sim_N", "F_ref_N"), "N", ".1f"),
        LiveRow("E true / estimated", ("E_true_Pa", "E_sim_Pa"), "N/mm²", ".0f", 1e6),
    ),
    of_steps=(
        ("E in 1 %, s", "E_time_to_1pct_s"),
        ("noise, %", "E_noise_pct"),
        ("F in 1 N, s", "tension_recovery_s"),
        ("peak, N", "tension_peak_error_N"),
    ),
)
