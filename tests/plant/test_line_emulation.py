"""A whole recording of an emulated line with stations in one call, against the rig and the line cycle by cycle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation, simulate_emulated
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor
from hilbench.runs.config import load

from .cycles import cycle_by_cycle

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
CYCLE_S, ROWS = 0.003, 300


def of_a_bench(name: str, *effects: EffectEntry) -> ModelParameters:
    """The machine of a shipped config, with effects."""
    return load(CONFIGS / name)[0].web_line.with_effects(*effects)


def of_station(effect: str, station: str, **parameters: float) -> EffectEntry:
    return EffectEntry(effect=effect, station=station, parameters=parameters)


def speeds(rows: int, axes: int) -> np.ndarray:
    """The line comes to speed, its tensions and carriages are pulled to and fro; (rows, axes) m/s."""
    t = np.arange(rows) * CYCLE_S
    line = np.minimum(1.2 * t, 0.6)
    return np.column_stack([line * (1.0 + 2e-3 * (axes - k) * np.sin(4.0 * t + k)) for k in range(axes)])


OF_LINES = [
    (
        "line_with_dancer.yaml",
        (2, 3),
        {"dancer": "x_dancer_m"},
        (
            of_station("carriage_coulomb_friction", "dancer", force_N=6.0),
            EffectEntry(effect="coulomb_friction", axis=2, parameters={"force_N": 4.0}),
        ),
        {},
    ),
    (
        "line_with_dancer.yaml",
        (2, 3),
        {"dancer": "x_dancer_m"},
        (of_station("carriage_force", "dancer", force_N=-8.0),),
        {"dancer": 160.0 + 20.0 * np.sin(0.03 * np.arange(ROWS))},
    ),
    (
        "winding_line.yaml",
        (1, 2, 3),
        {"store": "x_store_m", "unwinder": "r_unwinder_m"},
        (of_station("reel_radius", "unwinder", relative_change=0.01),),
        {},
    ),
]


@pytest.mark.parametrize(("name", "load_axes", "sensors", "effects", "forces_N"), OF_LINES)
def test_recording_in_one_call_is_what_the_bench_does_cycle_by_cycle(
    name: str,
    load_axes: tuple[int, ...],
    sensors: dict[str, str],
    effects: tuple[EffectEntry, ...],
    forces_N: dict[str, np.ndarray],
) -> None:
    parameters = of_a_bench(name, *effects)
    n, k = parameters.axis_count, parameters.span_count
    commands = speeds(ROWS, n)
    boundary = np.tile([parameters.upstream_strain, parameters.boundary.downstream_tension_N], (ROWS, 1))
    emulation = Emulation(CYCLE_S, tuple(CoupledMotor(axis=axis) for axis in load_axes))
    given = emulation, parameters, lay.pack(parameters), commands, boundary
    found = simulate_emulated(*given, sensors=list(sensors), forces_N=forces_N)
    of_axes = [entry for entry in parameters.effects if entry.axis is not None]
    of_line = [entry for entry in parameters.effects if entry.axis is None]
    line = LineFollower(parameters.model_copy(update={"effects": tuple(of_line)}))
    beside = {
        "effects": of_axes,
        "sensors": tuple(sensors.values()),
        "inputs": {f"force_{station}_N": told_N for station, told_N in forces_N.items()},
    }
    expected = cycle_by_cycle(line, parameters, load_axes, commands, CYCLE_S, **beside)
    assert found.sensors_m is not None
    np.testing.assert_allclose(found.x_m, expected[:, :n], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.tau_Nm, expected[:, n : 2 * n], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.F_N, expected[:, 2 * n : 2 * n + k], rtol=0, atol=1e-2)
    np.testing.assert_allclose(found.sensors_m, expected[:, 2 * n + k :], rtol=0, atol=1e-7)
    assert np.ptp(expected[:, 2 * n : 2 * n + k], axis=0).min() > 0.3
    assert np.ptp(expected[:, 2 * n + k]) > 5e-4
