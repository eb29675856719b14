"""A drive at its torque limit is told as that, and not as something of the web."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.bench.samples import sample_of_two_axes

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.reports.notice import Notice
from hilbench.bench.tasks.saturation import SaturationWatch
from hilbench.errors import BenchFaultError
from hilbench.runs.config import load_with_overrides
from hilbench.topology.sample import CycleSample

CONFIG = Path(__file__).parents[2] / "bench_configs" / "web_section_step.yaml"
INTERNAL_LIMIT = 0x0800


def bench(*changes: str) -> Bench:
    return Bench(load_with_overrides(CONFIG, changes=changes).config, participants=Participants.IN_PROCESS)


def texts(notices: list[Notice], source: str) -> list[str]:
    return [notice.text for notice in notices if notice.source == source]


@pytest.mark.parametrize("speed_m_s", [0.4, 3.0])
def test_a_step_of_the_line_speed_that_no_drive_can_follow_is_no_web_break(speed_m_s: float) -> None:
    with bench() as running:
        running.run(0.5)
        running.set("line_speed_m_s", speed_m_s)
        running.run(2.0)
        assert running.last.v2_m_s == pytest.approx(speed_m_s, abs=0.01)
        assert running.last.F_true_N == pytest.approx(80.0, abs=1.0)
        said = texts(running.notices, "saturation")
        assert len(said) == 4  # both axes, reached and left
        assert sum("axis 1 is at its limit" in text for text in said) == 1
        assert sum("axis 2 has left its limit" in text for text in said) == 1
        codes = [notice.text[:10] for notice in running.notices if "EMCY" in notice.text]
        assert codes == ["EMCY FF12h", "EMCY clear"]


def test_a_light_web_on_drives_that_are_quick_beside_the_cycle_breaks_when_it_breaks_and_not_in_a_ramp() -> None:
    """Their torque at SYNC is a third less than what accelerates the rollers in the mean of a cycle of 5 ms."""
    running = bench(
        "cycle_time_s=0.005",
        "machine.web.youngs_modulus_Pa=0.9e9",
        "machine.drives.velocity_kp_Nm_s_per_rad=7",
        "machine.drives.velocity_ki_Nm_per_rad=150",
        "machine.boundary.upstream_tension_N=7",
        "machine.boundary.downstream_tension_N=5",
        "controllers.tension_control.set_point_N=6",
        "controllers.tension_control.bandwidth_rad_per_s=2",
    )

    def run() -> None:
        with running:
            running.ramp("line_speed_m_s", 3.0, 2.0)
            running.run(1.0)
            assert running.last.F_sim_N == pytest.approx(running.last.F_true_N, rel=0.02)
            running.step("load.web.broken", 1.0)
            running.run(1.0)

    with pytest.raises(BenchFaultError, match="web break"):
        run()
    assert running.fault_time_s is not None
    assert 3.0 < running.fault_time_s < 3.5


def test_a_line_too_heavy_for_its_drives_runs_at_their_limit_and_says_so_once() -> None:
    with bench("machine.rollers.inertia_kg_m2=100") as running:
        running.ramp("line_speed_m_s", 0.3, 0.5)
        running.run(1.0)
        assert not [notice for notice in running.notices if "FF15" in notice.text or "FF16" in notice.text]
        assert len(texts(running.notices, "saturation")) <= 2


def test_a_web_that_breaks_while_the_torque_is_at_its_limit_is_told_when_it_is_free_again() -> None:
    def break_at_speed(running: Bench) -> None:
        with running:
            running.run(0.5)
            running.set("line_speed_m_s", 3.0)
            running.run(0.1)
            running.step("load.web.broken", 1.0)
            running.run(2.0)

    running = bench()
    with pytest.raises(BenchFaultError, match="web break"):
        break_at_speed(running)
    # At its limit until 0.87 s; 50 ms later it counts as free, and the window of the verdict is 40 ms.
    assert running.fault_time_s is not None
    assert 0.87 < running.fault_time_s < 1.1


def sample(t_s: float, tau1_Nm: float = 0.0, statusword2: int = 0) -> CycleSample:
    return sample_of_two_axes(t_s=t_s, tau1_Nm=tau1_Nm, statusword2=statusword2)


def test_a_torque_that_goes_to_and_fro_at_its_limit_is_one_saturation() -> None:
    watch = SaturationWatch(load_with_overrides(CONFIG).config)
    said = []
    for k in range(1000):
        at_limit = k < 500 and k % 7 < 3
        said += [text for _, text in watch.update(sample(0.002 * k, tau1_Nm=9.0 if at_limit else 8.0))]
    assert len(said) == 2
    assert "axis 1 is at its limit (torque 9 N·m" in said[0]
    assert "at it for 0.432 s within 1 s" in said[1]


def test_a_drive_that_says_so_itself_is_believed() -> None:
    watch = SaturationWatch(load_with_overrides(CONFIG).config)
    ((_, said),) = watch.update(sample(0.0, statusword2=INTERNAL_LIMIT))
    assert "axis 2 is at its limit (statusword bit 11" in said
