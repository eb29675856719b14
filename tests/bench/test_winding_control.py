"""Controllers of reels, dancers and accumulators, on lines that the plant steps; the published lines with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.plant.models import DEMONSTRATOR
from tools import published_lines as published

from hilbench.bench.tasks.web_winding_control import ROUNDED, DancerPosition, ReelMechanics, ReelTension, eased
from hilbench.plant.web_line.parameters import ModelParameters, load_model
from hilbench.plant.web_line.stations import Dancer

ROLLER = {"type": "roller"}
DANCER = {
    "type": "dancer", "name": "dancer", "radius_m": 0.05, "inertia_kg_m2": 0.0025, "mass_kg": 5.0, "force_N": 160.0,
    "viscous_friction_N_s_per_m": 300.0, "lower_stop_m": -0.3, "upper_stop_m": 0.3,
}  # fmt: skip
CYCLE_S = 0.002


def line_with_dancer() -> ModelParameters:
    web = {**DEMONSTRATOR["web"], "span_length_m": 0.8}
    return ModelParameters.model_validate({**DEMONSTRATOR, "web": web, "stations": [ROLLER, DANCER, ROLLER]})


def courses_of_the_dancer(*, controlled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Its position and the tension behind it, while the line goes from 1 to 2 m/s and the dancer from 0 to 0.05 m."""
    model = line_with_dancer()
    stand, loop = published.Stand(model, 1.0, CYCLE_S), DancerPosition(Dancer(**DANCER), 4.0, 0.5)
    before_m_s = 1.0
    for cycle in range(round(8.0 / CYCLE_S)):
        t_s = cycle * CYCLE_S
        behind_m_s = float(np.clip(1.0 + (t_s - 1.0), 1.0, 2.0))
        wanted_m = 0.05 if t_s > 4.0 else 0.0
        stand.velocity(1, before_m_s if controlled else behind_m_s * 0.999)
        stand.velocity(2, behind_m_s)
        before_m_s = loop.velocity(behind_m_s, wanted_m, 0.0, stand.now["x_dancer_m"], CYCLE_S)
        stand.step()
        if cycle == 0:
            positions = [stand.now["x_dancer_m"]]
            continue
        positions.append(stand.now["x_dancer_m"])
    return np.array(positions), stand.course().tensions_N[:, 1]


def test_a_dancers_loop_keeps_its_position_at_a_ramp_and_takes_it_where_it_is_wanted() -> None:
    positions_m, tensions_N = courses_of_the_dancer(controlled=True)
    t_s = CYCLE_S * np.arange(1, len(positions_m) + 1)
    assert np.max(np.abs(positions_m[t_s < 4.0])) < 0.02
    assert positions_m[t_s < 4.0][-1] == pytest.approx(0.0, abs=1e-3)
    assert positions_m[-1] == pytest.approx(0.05, abs=1e-3)
    assert np.mean(tensions_N[-500:]) == pytest.approx(80.0, abs=0.5)
    alone_m, _ = courses_of_the_dancer(controlled=False)
    assert np.max(np.abs(alone_m)) > 0.002


def test_a_reels_torque_knows_its_inertia_and_its_side() -> None:
    model = load_model(Path(published.FOLDER) / "koc_2002.yaml")
    unwinder, winder = ReelMechanics.of_model(model, 1), ReelMechanics.of_model(model, 3)
    # By hand: 950 kg/m³ of a roll of 0.1 m width between 0.033 and 0.098 m, on a reel of 0.002 and a rotor of 0.0015.
    assert unwinder.inertia_kg_m2(0.098) == pytest.approx(0.0035 + 0.5 * np.pi * 95.0 * (0.098**4 - 0.033**4))
    assert winder.inertia_kg_m2(0.033) == pytest.approx(0.0035)
    assert unwinder.torque_Nm(15.0, 0.0, 0.098) == pytest.approx(-1.47)
    assert winder.torque_Nm(15.0, 2.0, 0.033) == pytest.approx(15.0 * 0.033 + 0.0035 * 2.0 / 0.033)
    with pytest.raises(ValueError, match="axis 2 is no reel"):
        ReelMechanics.of_model(model, 2)


def test_a_reels_torque_stays_within_its_motors_limit_and_does_not_wind_up_there() -> None:
    reel = ReelMechanics.of_model(load_model(Path(published.FOLDER) / "koc_2002.yaml"), 3)
    loop = ReelTension(reel, 0.0, 2.0, limit_Nm=0.4)
    for _ in range(1000):
        assert loop.torque_Nm(15.0, 0.0, 0.0, 0.033, 0.01) == 0.4
    assert loop.torque_Nm(10.0, 10.0, 0.0, 0.033, 0.01) == pytest.approx(0.33)


def test_koc_s_plant_with_pid_deviates_as_published_within_a_third() -> None:
    found = published.koc_pid()
    assert found.cell_pct((3, 4), 15.0) == pytest.approx(75.0, rel=1 / 3)


def test_koc_s_plant_with_feed_forward_stays_within_2_percent() -> None:
    found = published.koc_feed_forward()
    assert np.ptp(found.speeds_m_s[:, 1]) > 0.99
    for cell in ((1, 2), (3, 4)):
        assert found.cell_pct(cell, 15.0) < 2.0


@pytest.mark.parametrize("duration_s", [1.0, 2.0])
def test_giannoccaro_s_line_keeps_its_tensions_within_3_percent_at_a_ramp_of_the_speed(duration_s: float) -> None:
    found = published.film(duration_s)
    assert found.speeds_m_s[-1, 3] == pytest.approx(2.0, abs=1e-3)
    for span in (1, 2, 3):
        assert found.deviation_pct(span, 14.0, published.SETTLED_S) < 3.0


@pytest.mark.slow
def test_a_reel_change_at_full_speed_leaves_the_tension_behind_the_accumulator_within_3_percent() -> None:
    found = published.reel_change()
    assert found.speeds_m_s[:, 0].min() == pytest.approx(0.0, abs=1e-3)
    stands = (found.time_s > 7.0) & (found.time_s < 9.9)
    assert found.speeds_m_s[stands, 0] == pytest.approx(0.0, abs=1e-3)
    assert found.behind_pct(300.0) < 3.0
    assert published.reel_change(feed_forward=False).behind_pct(300.0) > 3.0


def test_a_reel_change_shared_between_both_ends_of_the_accumulator_leaves_each_within_3_percent() -> None:
    """What comes in stops and starts slower, and stands for less long: as much web is stored as in the paper."""
    found = published.reel_change(behind_takes=0.5, ramp_s=6.0, stands_s=2.0)
    assert found.changed_pct(1) < 3.0
    assert found.changed_pct(18) < 3.0
    # No force on the carriage makes the ends differ by less than what 17 rollers need between them, of 0.01/0.075² kg
    # and, on average, half the acceleration, forward and back; the rest is their friction.
    running = found.time_s > published.SETTLED_S
    ends_N = (found.tensions_N[:, 0] - found.tensions_N[:, 17])[running]
    needed_N = 2.0 * 17.0 * 0.01 / 0.075**2 * 0.5 * 4.2 / 6.0 / (1.0 - ROUNDED)
    assert needed_N <= np.ptp(ends_N) < needed_N + 17.0 * 0.5 * 0.1 * 4.2


@pytest.mark.parametrize("rounded", [0.05, 0.125, 0.5])
def test_a_ramp_of_bounded_jerk_is_as_fast_as_its_rounding_asks(rounded: float) -> None:
    times = np.linspace(-0.5, 1.5, 4001)
    way, speed = np.array([eased(time, rounded) for time in times]).T
    assert way[[0, 2000, -1]] == pytest.approx([0.0, 0.5, 1.0])
    assert np.gradient(way, times) == pytest.approx(np.where((times > 0.0) & (times < 1.0), speed, 0.0), abs=0.02)
    assert speed.max() == pytest.approx(1.0 / (1.0 - rounded), rel=1e-3)
    jerk = np.gradient(speed, times)
    assert np.abs(jerk).max() == pytest.approx(0.5 * np.pi * speed.max() / rounded, rel=0.01)
    assert np.abs(np.diff(jerk)).max() < 0.05 * np.abs(jerk).max()  # it does not jump
