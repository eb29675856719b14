"""A whole recording of an emulated web in one call, against the rig and the emulated web cycle by cycle."""

from __future__ import annotations

import numpy as np
import pytest

from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation, simulate_emulated
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor

from .cycles import cycle_by_cycle
from .models import effect, line_of, model

CYCLE_S = 0.002


@pytest.mark.parametrize(
    ("parameters", "load_axes"),
    [
        (model(web_load=[False, True]), (2,)),
        (model(effect("web_slip", creep_per_N=2e-6)), (1, 2)),
        (line_of(3), (2, 3)),
        (line_of(4), (3, 1)),
    ],
)
def test_recording_in_one_call_is_what_the_bench_does_cycle_by_cycle(
    parameters: ModelParameters, load_axes: tuple[int, ...]
) -> None:
    rows, n = 400, parameters.axis_count
    v = 0.5 * np.sin(2.0 * np.pi * np.arange(rows) * CYCLE_S)
    commands = np.column_stack([v * (1.0 + 1e-5 * k) for k in range(n)])
    boundary = np.tile([parameters.upstream_strain, parameters.boundary.downstream_tension_N], (rows, 1))
    p = lay.pack(parameters)
    emulation = Emulation(CYCLE_S, tuple(CoupledMotor(axis=axis) for axis in load_axes))
    found = simulate_emulated(emulation, parameters, p, commands, boundary)
    expected = cycle_by_cycle(LineFollower(parameters), parameters, load_axes, commands, CYCLE_S)
    # Positions to rounding; a tension is E·S/L of that.
    np.testing.assert_allclose(found.x_m, expected[:, :n], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.tau_Nm, expected[:, n : 2 * n], rtol=0, atol=1e-4)
    np.testing.assert_allclose(found.F_N, expected[:, 2 * n :], rtol=0, atol=1e-3)
    assert np.ptp(expected[:, 2 * n :], axis=0).min() > 0.3
    assert np.abs(expected[:, n : 2 * n]).max(axis=0).min() > 0.3
