"""Pictures of a line with reels: what is drawn of its axes are velocities of the web."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.apps.report.panel import ShownRun, recorded_panels
from hilbench.results.recording import Recording

SPEED_M_S, STRAIN, WOUND = 2.0, 0.0034, 0.003
THICKNESS_M = 0.3e-3


def wound(start_m: float, sign: float, web_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion x = r0·phi and radius of a reel from (sign -1) or onto which so much web has come: r² = r0² ± w·h/pi."""
    radius_m = np.sqrt(start_m**2 + sign * web_m * THICKNESS_M / np.pi)
    return start_m * 2.0 * np.pi * (radius_m - start_m) / (sign * THICKNESS_M), radius_m


def winding(duration_s: float = 20.0) -> Recording:
    """Unwinder, roller, rewinder: the web comes with one strain and has another in both spans."""
    t_s = np.arange(0.0, duration_s, 0.01)
    behind_m = SPEED_M_S * t_s
    off_m, unwinder_m = wound(0.1, -1.0, behind_m * (1.0 + WOUND) / (1.0 + STRAIN))
    on_m, rewinder_m = wound(0.033, 1.0, behind_m)
    constant = np.ones_like(t_s)
    return Recording(
        {
            "t_s": t_s,
            "line_speed_cmd_m_s": SPEED_M_S * constant,
            "x1_m": off_m,
            "x2_m": behind_m,
            "x3_m": on_m,
            "v1_cmd_m_s": np.gradient(off_m, t_s),
            "v2_cmd_m_s": SPEED_M_S * constant,
            "v3_cmd_m_s": np.gradient(on_m, t_s),
            "strain_prev": WOUND * constant,
            "strain1_true": STRAIN * constant,
            "strain2_true": STRAIN * constant,
            "r_unwinder_true_m": unwinder_m,
            "r_rewinder_true_m": rewinder_m,
        },
    )


def test_reels_are_drawn_with_the_velocity_of_their_web() -> None:
    recording = winding()
    (picture,) = (each for each in recorded_panels(recording).pictures if each.name == "velocities")
    velocities, fine = picture.charts(ShownRun(recording))
    middle = slice(200, -200)
    assert len(velocities.curves) == 6
    for curve in velocities.curves:
        assert curve.values[middle] == pytest.approx(SPEED_M_S, abs=2e-3), curve.name
    differences = {curve.name: curve.values[middle] for curve in fine.curves}
    off_mm_s = 1e3 * SPEED_M_S * ((1.0 + WOUND) / (1.0 + STRAIN) - 1.0)
    assert differences["axis 1 − axis 2"] == pytest.approx(off_mm_s, abs=0.1)
    assert differences["axis 2 − axis 3"] == pytest.approx(0.0, abs=0.1)
    asked = [curve.values[middle] for curve in fine.curves if curve.dash]
    assert [float(np.mean(each)) for each in asked] == pytest.approx([off_mm_s, 0.0], abs=0.01)
