"""Effects that the axes of stands have, injected while a bench runs: by path, over the bus, and taken away again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import config

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants

AXIS = "hardware.effects.{}.axis1.{}"
DRAG = AXIS.format("quadratic_drag", "coefficient_N_s2_per_m2")
SHARE = AXIS.format("load_dependent_friction", "share")
VISCOUS = AXIS.format("viscous_friction", "coefficient_N_s_per_m")
FED = AXIS.format("feed_forward", "viscous_share")
ENCODER = AXIS.format("encoder_error", "amplitude_rad")
RIPPLE = AXIS.format("torque_ripple_load", "relative_amplitude")
SPLICE = "load.effects.splice.{}"


def torque(bench: Bench) -> np.ndarray:
    """Of axis 1, which carries no web, once it has settled."""
    bench.run(0.5)
    return np.array([bench.cycle().tau1_Nm for _ in range(250)])


def test_what_is_injected_shows_in_what_the_drive_reports_and_ends_with_it(tmp_path: Path) -> None:
    with Bench(config(tmp_path), participants=Participants.IN_PROCESS) as running:
        running.ramp("line_speed_m_s", 1.0, 0.4)
        plain = torque(running)
        running.set(DRAG, 20.0)  # N at 1 m/s, through a radius of 0.2 m and a gear of 5
        assert torque(running).mean() - plain.mean() == pytest.approx(20.0 / 25.0, abs=0.02)
        running.set(SHARE, 0.2)
        assert torque(running).mean() == pytest.approx(20.0 / 25.0 / 0.8, abs=0.02)
        running.set(RIPPLE, 0.5)
        assert torque(running).std() > 2.0 * plain.std()
        for path in (DRAG, SHARE, RIPPLE):
            running.set(path, 0.0)
        running.set(VISCOUS, 20.0)
        running.set(FED, 0.75)
        assert torque(running).mean() == pytest.approx(0.25 * 20.0 / 25.0, abs=0.02)
        running.set(VISCOUS, 0.0)
        running.set(ENCODER, 0.02)
        assert torque(running).std() > 2.0 * plain.std()
        running.set(ENCODER, 0.0)
        after = torque(running)
        assert after.mean() == pytest.approx(plain.mean(), abs=0.02)
        assert after.std() < 1.3 * plain.std()


def test_the_loops_of_a_drive_are_made_other_ones_under_way(tmp_path: Path) -> None:
    """A drive with a slow current loop and little gain swings longer after a step of the speed."""
    with Bench(config(tmp_path), participants=Participants.IN_PROCESS) as running:
        running.ramp("line_speed_m_s", 0.5, 0.2)
        found = []
        for gain, lag_s in ((0.0, 0.0), (-0.6, 0.02)):
            running.set(AXIS.format("drive_gain", "kp_relative_change"), gain)
            running.set(AXIS.format("drive_lag", "lag_s"), lag_s)
            running.run(0.6)
            running.step("line_speed_m_s", 0.6)
            speeds = np.array([running.cycle().v1_m_s for _ in range(200)])
            found.append(float(np.max(speeds)))
            running.ramp("line_speed_m_s", 0.5, 0.4)
        assert found[1] > found[0] + 0.005


def test_a_splice_comes_into_the_emulated_web_when_it_is_asked_for(tmp_path: Path) -> None:
    with Bench(config(tmp_path), participants=Participants.IN_PROCESS) as running:
        running.ramp("line_speed_m_s", 1.0, 0.4)
        running.run(0.5)
        before = np.mean([running.cycle().F_true_N for _ in range(100)])
        running.set(SPLICE.format("length_m"), 0.2)
        running.step(SPLICE.format("relative_change"), 1.0)
        tensions = np.array([running.cycle().F_true_N for _ in range(250)])
        assert tensions.max() > 1.02 * before  # the drives give way to most of it
