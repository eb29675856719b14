"""The active damping: on rollers and a web written out here, and on the bench."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.tiers import slow

from hilbench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.control.web_line.swing_damping import SwingDamping, SwingPlant, damp_measured

CONFIG = Path(__file__).parents[2] / "bench_configs" / "web_section_step.yaml"
DEMONSTRATOR = SwingPlant(
    span_length_m=1.0,
    section_m2=32.5e-6,
    upstream_strain=80.0 / (8.7e9 * 32.5e-6),
    downstream_strain=80.0 / (8.7e9 * 32.5e-6),
    mass1_kg=29.8,
    mass2_kg=29.8,
    velocity_kp1_N_s_per_m=937.5,
    velocity_kp2_N_s_per_m=937.5,
    current_loop_time_constant_s=0.001,
    sample_time_s=0.001,
    torque_limit_N=225.0,
    cycle_s=0.002,
    least_travel_m=1e-4,
)
#: Heavier rollers on a foil, with stiffer drives and a faster bus.
OTHER = SwingPlant(
    span_length_m=2.5,
    section_m2=1.0e-5,
    upstream_strain=50.0 / (4.0e9 * 1.0e-5),
    downstream_strain=50.0 / (4.0e9 * 1.0e-5),
    mass1_kg=60.0,
    mass2_kg=45.0,
    velocity_kp1_N_s_per_m=4000.0,
    velocity_kp2_N_s_per_m=200.0,
    current_loop_time_constant_s=0.0005,
    sample_time_s=0.001,
    torque_limit_N=500.0,
    cycle_s=0.001,
    least_travel_m=1e-4,
)
Command = Callable[[float, float], float]


def damping_of(plant: SwingPlant, damping_ratio: float, modulus_Pa: float) -> Command:
    """Correction of axis 1 from the positions of both axes, cycle by cycle."""
    damping = SwingDamping(plant, damping_ratio, modulus_Pa)
    return lambda x1_m, x2_m: damp_measured(damping.vector, damping.coherence, np.array([x1_m, x2_m]), 0.0)


def swing_m(
    plant: SwingPlant, modulus_Pa: float, command: Command, speed_m_s: float, duration_s: float
) -> NDArray[np.float64]:
    """Elongation of the span (beyond the steady one) each cycle, 0.05 mm too small at the start."""
    stiffness_N_per_m = modulus_Pa * plant.section_m2 / plant.span_length_m
    at_rest = plant.upstream_strain if speed_m_s >= 0.0 else plant.downstream_strain
    x1 = x2 = 0.0
    v1 = v2 = speed_m_s
    force1 = force2 = 0.0
    unstretched = (plant.span_length_m + 5e-5) / (1 + at_rest)
    waiting = acting = 0.0
    course, h = [], 1e-4
    for _ in range(round(duration_s / plant.cycle_s)):
        acting, waiting = waiting, command(x1, x2)
        for fine in range(round(plant.cycle_s / h)):
            strain = plant.span_length_m / unstretched - 1
            if fine % round(plant.sample_time_s / h) == 0:
                wanted1 = plant.velocity_kp1_N_s_per_m * (speed_m_s + acting - v1)
                wanted2 = plant.velocity_kp2_N_s_per_m * (speed_m_s - v2)
            force1 += (wanted1 - force1) * h / plant.current_loop_time_constant_s
            force2 += (wanted2 - force2) * h / plant.current_loop_time_constant_s
            pull = stiffness_N_per_m * plant.span_length_m * (strain - at_rest)
            v1 += h * force1 / plant.mass1_kg
            v2 += h * (force2 - pull) / plant.mass2_kg
            x1 += h * v1
            x2 += h * v2
            into, out_of = (at_rest, strain) if speed_m_s >= 0.0 else (strain, at_rest)
            unstretched += h * (v1 / (1 + into) - v2 / (1 + out_of))
        course.append(plant.span_length_m * (strain - at_rest))
    return np.array(course)


@pytest.mark.parametrize("speed_m_s", [-0.2, 0.0, 3.0])
@pytest.mark.parametrize("share", [0.6, 1.0, 1.4])
@pytest.mark.parametrize(("plant", "modulus_Pa"), [(DEMONSTRATOR, 8.7e9), (OTHER, 4.0e9)])
def test_the_swing_of_roller_2_does_not_come_back_also_where_e_is_another_than_believed(
    plant, modulus_Pa, share, speed_m_s
):
    true_Pa = share * modulus_Pa
    period_s = 2 * math.pi / math.sqrt(true_Pa * plant.section_m2 / plant.span_length_m / plant.mass2_kg)
    periods = 3 * period_s
    damped = swing_m(plant, true_Pa, damping_of(plant, 1.3, modulus_Pa), speed_m_s, periods)
    left_alone = swing_m(plant, true_Pa, lambda x1, x2: 0.0, speed_m_s, periods)
    assert damped[0] == pytest.approx(-5e-5, rel=0.05)
    assert damped.max() < 0.25 * 5e-5 < 0.4 * 5e-5 < left_alone.max()
    damped_back, back = (course[np.argmax(course) :].min() for course in (damped, left_alone))
    assert damped_back > -0.03 * 5e-5 > -0.15 * 5e-5 > back


def test_a_damping_ratio_of_zero_adds_nothing():
    damping = damping_of(DEMONSTRATOR, 0.0, 8.7e9)
    assert [damping(0.006 * k, 0.006 * k + 1e-5 * k % 3) for k in range(10)] == [0.0] * 10


def test_a_steady_difference_of_the_speeds_is_none_of_its_business():
    """At 15 N more than upstream roller 1 is slower, as mass conservation asks."""
    damping = damping_of(DEMONSTRATOR, 1.3, 8.7e9)
    strain = 95.0 / (8.7e9 * 32.5e-6)
    v2 = 3.0
    v1 = v2 * (1 + DEMONSTRATOR.upstream_strain) / (1 + strain)
    told = [damping(v1 * 0.002 * k, v2 * 0.002 * k) for k in range(3000)]
    assert max(map(abs, told[2500:])) < 1e-9


@pytest.mark.parametrize("speed_m_s", [-8.0, -3.0, -0.5, 3.0])
def test_a_long_way_at_constant_speeds_leaves_nothing_to_add_in_reverse_either(speed_m_s):
    damping = damping_of(DEMONSTRATOR, 1.3, 8.7e9)
    noise_m = np.random.default_rng(5).normal(0.0, 2e-9, (30_000, 2))
    commands = []
    for cycle, (noise1, noise2) in enumerate(noise_m):
        way = speed_m_s * cycle * DEMONSTRATOR.cycle_s  # what comes in is a thousandth of the strain off
        commands.append(damping(way * (1 + 3e-7) + noise1, way + noise2))
    assert np.max(np.abs(commands[5_000:])) < 2e-4


def test_positions_of_different_instants_leave_the_command_as_it_was():
    damping = damping_of(DEMONSTRATOR, 1.3, 8.7e9)
    for k in range(5):
        before = damping(0.006 * k, 0.006 * k + 1e-6 * k * k)
    assert before != 0.0
    assert damping(0.006 * 4, 0.006 * 5 + 25e-6) == before  # axis 1 is a cycle late
    after = damping(0.006 * 6, 0.006 * 6 + 36e-6)
    assert abs(after) < 3 * abs(before)


def test_it_asks_for_half_of_the_torque_at_most():
    damping = damping_of(DEMONSTRATOR, 2.0, 8.7e9)
    damping(0.0, 0.0)
    told = [damping(0.0, 9e-5 * k) for k in range(1, 20)]
    assert max(told) == pytest.approx(0.5 * 225.0 / 937.5)


def step_of_e(share: float, speed_m_s: float, *changes: str) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Time since a step of E and true tension minus set-point; standard deviation of the tension before."""
    with Bench(CONFIG, changes=changes, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", speed_m_s, duration_s=max(1.0, 0.5 * speed_m_s))
        bench.run(2.0)
        at_s = bench.time_s
        bench.step("load.web.youngs_modulus_Pa", 8.7e9 * (1 + share))
        bench.run(0.8)
    recording = bench.recording
    time_s = recording.time_s - at_s
    deviation_N = recording["F_true_N"] - 80.0
    return time_s[time_s > 0], deviation_N[time_s > 0], float(np.std(deviation_N[(time_s > -1) & (time_s <= 0)]))


def swing_N(deviation_N: NDArray[np.float64]) -> NDArray[np.float64]:
    """What goes to and fro in less than 0.1 s."""
    return np.asarray(deviation_N[25:-25] - np.convolve(deviation_N, np.full(51, 1 / 51), "valid"))


@pytest.mark.parametrize(
    ("share", "speed_m_s"),
    [(0.207, 3.0), *slow((0.4, 0.5), (0.4, 8.0), (-0.4, 0.5), (-0.4, 3.0), (-0.207, 8.0), (0.02, 3.0))],
)
def test_the_tension_does_not_ring_after_a_step_of_e(share, speed_m_s):
    time_s, deviation_N, _ = step_of_e(share, speed_m_s)
    back = -np.sign(share) * deviation_N
    assert np.max(back) < 3.0  # beyond the set-point, on the other side
    assert np.max(np.abs(swing_N(deviation_N)[time_s[25:-25] >= 0.15])) < 0.5


@pytest.mark.slow
def test_without_damping_it_rings_and_with_it_the_steady_tension_is_no_noisier():
    time_s, ringing_N, noise_N = step_of_e(0.207, 3.0, "controllers.tension_control.swing_damping_ratio=0")
    assert np.max(-ringing_N) > 5.0
    assert np.max(np.abs(swing_N(ringing_N)[time_s[25:-25] >= 0.15])) > 3.0
    assert step_of_e(0.207, 3.0)[2] < noise_N
