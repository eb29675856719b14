"""A whole recording of an imitated line with stations in one call, against the rig and the line cycle by cycle."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.imitation import Imitation
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.line_imitation import simulate_imitated_line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor
from hilbench.runs.config import load

from .cycles import cycle_by_cycle

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
CYCLE_S = 0.003


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


@pytest.mark.parametrize(
    ("name", "load_axes", "sensors", "effects"),
    [
        (
            "line_with_dancer.yaml",
            (2, 3),
            {"dancer": "x_dancer_m"},
            (
                of_station("carriage_coulomb_friction", "dancer", force_N=6.0),
                EffectEntry(effect="coulomb_friction", axis=2, parameters={"force_N": 4.0}),
            ),
        ),
        (
            "winding_line.yaml",
            (1, 2, 3),
            {"store": "x_store_m", "unwinder": "r_unwinder_m"},
            (of_station("reel_radius", "unwinder", relative_change=0.01),),
        ),
    ],
)
def test_recording_in_one_call_is_what_the_bench_does_cycle_by_cycle(
    name: str, load_axes: tuple[int, ...], sensors: dict[str, str], effects: tuple[EffectEntry, ...]
) -> None:
    parameters, rows = of_a_bench(name, *effects), 300
    n, k = parameters.axis_count, parameters.span_count
    commands = speeds(rows, n)
    boundary = np.tile([parameters.upstream_strain, parameters.boundary.downstream_tension_N], (rows, 1))
    imitation = Imitation(CYCLE_S, tuple(CoupledMotor(axis=axis) for axis in load_axes))
    found = simulate_imitated_line(imitation, parameters, lay.pack(parameters), commands, boundary, list(sensors))
    of_axes = [entry for entry in parameters.effects if entry.axis is not None]
    of_line = [entry for entry in parameters.effects if entry.axis is None]
    line = LineFollower(parameters.model_copy(update={"effects": tuple(of_line)}))
    seen = tuple(sensors.values())
    expected = cycle_by_cycle(line, parameters, load_axes, commands, CYCLE_S, effects=of_axes, sensors=seen)
    assert found.sensors_m is not None
    np.testing.assert_allclose(found.x_m, expected[:, :n], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.tau_Nm, expected[:, n : 2 * n], rtol=0, atol=1e-3)
    np.testing.assert_allclose(found.F_N, expected[:, 2 * n : 2 * n + k], rtol=0, atol=1e-2)
    np.testing.assert_allclose(found.sensors_m, expected[:, 2 * n + k :], rtol=0, atol=1e-7)
    assert np.ptp(expected[:, 2 * n : 2 * n + k], axis=0).min() > 0.3
    assert np.ptp(expected[:, 2 * n + k]) > 5e-4
