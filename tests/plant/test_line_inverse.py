"""Inverse dynamics of a line against the simulation: the torques that a motion needs are those that made it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.plant.models import effect, model
from tests.simulated_recordings import PERIOD_S, experiment

from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.line_inverse import required_torques
from hilbench.plant.web_line.offline import simulate, start_state

FINE_S = 0.001


@pytest.mark.parametrize(
    "item",
    [
        effect("coulomb_friction", 2, force_N=4.0),
        effect("unbalance", 2, amplitude_Nm=0.5, phase_rad=-1.0),
        effect("load_dependent_friction", 2, share=0.1),
        effect("quadratic_drag", 2, coefficient_N_s2_per_m2=0.5),
        effect("inertia_mismatch", 1, relative_change=0.2),
        effect("torque_ripple_load", 1, relative_amplitude=0.2, order=2.0, phase_rad=0.8),
        effect("torque_scale", 2, relative_change=0.2),
        effect("torque_offset", 1, offset_Nm=0.1),
        effect("torque_delay", 2, delay_s=0.005),
        effect("feed_forward", 2, inertia_share=0.3),
        effect("encoder_error", 1, amplitude_rad=2e-3, phase_rad=1.0),
        effect("roller_eccentricity", 1, amplitude_m=1e-4),
        effect("elasticity_step", time_s=9.0, relative_change=0.2),
        effect("web_damping", time_constant_s=0.01),
        effect("web_slip", creep_per_N=2e-6),
        effect("span_length_error", relative_change=0.1),
        effect("upstream_disturbance", amplitude_N=4.0, frequency_Hz=0.8),
    ],
    ids=lambda item: item["effect"],
)
def test_the_torques_that_a_motion_needs_are_those_that_made_it(item: dict[str, Any]) -> None:
    plain = model()
    machine = plain.with_effects(EffectEntry.model_validate(item))
    run = experiment(plain, 16.0, seed=1)
    whole = round(PERIOD_S / FINE_S)
    commands = np.repeat(run.commands_m_s, whole, axis=0)
    boundary = np.tile([plain.upstream_strain, plain.boundary.downstream_tension_N], (len(commands), 1))
    parameters = lay.pack(machine)
    made = simulate(parameters, start_state(parameters, machine), commands, boundary, FINE_S)
    speed = np.gradient(made.x_m, FINE_S, axis=0)
    found = required_torques(parameters, machine, made.x_m, speed, np.gradient(speed, FINE_S, axis=0), boundary, FINE_S)
    moving = slice(round(1.6 / FINE_S), -100)
    assert np.max(np.abs(found.F_N[0, moving] - made.F_N[moving])) < 0.01
    # A torque that steps within a sample is known as its mean over some of them.
    mean = np.ones(40) / 40
    for axis in (0, 1):
        error = np.convolve(found.tau_Nm[0, moving, axis] - made.tau_Nm[moving, axis], mean, "valid")
        assert np.sqrt(np.mean(error**2)) < 2e-3
