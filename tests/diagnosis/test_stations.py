"""Lines with dancers, accumulators and reels: what a bench's recording of them tells of their effects."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.cli.in_process import hilbench
from tests.tiers import slow

from hilbench.bench.lifecycle.participants import Participants
from hilbench.diagnosis.free_rules import FreeRules
from hilbench.diagnosis.machines import emulation_of
from hilbench.diagnosis.measured import Measured, measured_from
from hilbench.diagnosis.predictor import choice
from hilbench.diagnosis.proposals import Proposer
from hilbench.diagnosis.search import search
from hilbench.diagnosis.selection import Selection
from hilbench.diagnosis.space import Space
from hilbench.diagnosis.terms import Place
from hilbench.diagnosis.web_line_bench_gap import figures_of_line
from hilbench.errors import UnusableInputError
from hilbench.plant.effects import STATION_EFFECTS, find_effect
from hilbench.plant.parameters import EffectEntry
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.emulation import Emulation, simulate_emulated
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load, load_with_overrides

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
DANCER, WINDING = CONFIGS / "line_with_dancer.yaml", CONFIGS / "winding_line.yaml"
CYCLE_S, TORQUE_NM = 0.003, 0.05


@cache
def machine(config: Path) -> ModelParameters:
    return load(config)[0].web_line


def emulation(config: Path) -> Emulation:
    model = machine(config)
    axes = [axis for axis in range(1, model.axis_count + 1) if model.carries_web_load(axis)]
    return Emulation(CYCLE_S, tuple(CoupledMotor(axis=axis) for axis in axes))


def commands(axes: int, duration_s: float) -> np.ndarray:
    """(n, axes) m/s: the line comes to speed, its first axis moves the carriage to and fro, the others the tensions."""
    t = np.arange(round(duration_s / CYCLE_S)) * CYCLE_S
    line = np.interp(t, [0.3, 1.5, 3.5, 4.5, duration_s - 0.5, duration_s], [0.0, 1.0, 1.0, 1.6, 1.6, 0.8])
    sway = np.where((t > 1.5) & (t < duration_s - 0.5), 0.08 * np.sin(2.0 * (t - 1.5)), 0.0)
    speeds = [line * (1.0 - 4e-5 * (axes - 1 - k) * (1.0 + 0.5 * np.sin(1.1 * t))) for k in range(axes)]
    return np.column_stack([speeds[0] + sway, *speeds[1:]])


def recorded(config: Path, entry: EffectEntry | None = None, seed: int = 1, duration_s: float = 6.5) -> Recording:
    """What a bench records of a line that has an effect, with the noise of its torques."""
    model, rng = machine(config), np.random.default_rng(seed)
    told, sensors = commands(model.axis_count, duration_s), load(config)[0].load.measured
    boundary = np.tile([model.upstream_strain, model.boundary.downstream_tension_N], (len(told), 1))
    true = model if entry is None else model.with_effects(entry)
    run = simulate_emulated(emulation(config), true, lay.pack(true), told, boundary, sensors=sensors)
    channels = {"t_s": np.arange(len(told)) * CYCLE_S, "strain_prev": boundary[:, 0], "F_next_N": boundary[:, 1]}
    for k in range(model.axis_count):
        channels |= {f"v{k + 1}_cmd_m_s": told[:, k], f"v{k + 1}_m_s": run.v_m_s[:, k], f"x{k + 1}_m": run.x_m[:, k]}
        channels[f"tau{k + 1}_Nm"] = run.tau_Nm[:, k] + TORQUE_NM * rng.standard_normal(len(told))
    channels["tau_load_cmd_Nm"] = np.ones(len(told))
    assert run.sensors_m is not None
    for k, name in enumerate(sensors):
        symbol = "x" if name in [each.station.name for each in model.carriages] else "r"
        channels[f"{symbol}_{name}_meas_m"] = run.sensors_m[:, k]
    return Recording(channels)


def of_station(effect: str, station: str, value: float) -> EffectEntry:
    (parameter,) = find_effect(effect).parameters
    return EffectEntry(effect=effect, station=station, parameters={parameter.name: value})


def searched(config: Path, data: Measured) -> Selection:
    """What a search among the effects of stations, and friction and inertia of axes, finds."""
    model = machine(config)
    others = [find_effect(name) for name in ("coulomb_friction", "viscous_friction", "inertia_mismatch")]
    predictor = choice(model, data, emulation(config)).predictor
    space = Space(model, predictor, data.period_s)
    return search(FreeRules(space, Proposer(model, data, [*others, *STATION_EFFECTS])))


@pytest.mark.parametrize("config", [DANCER, WINDING], ids=["dancer", "winding"])
def test_a_right_model_leaves_the_noise_and_another_more(config: Path) -> None:
    station = "dancer" if config is DANCER else "store"
    hidden = of_station("carriage_coulomb_friction", station, 15.0)
    model, right = machine(config), machine(config).with_effects(hidden)
    data = measured_from(recorded(config, hidden), model, "the bench")
    predictor = choice(model, data, emulation(config)).predictor
    assert any(f"x_{station}_meas_m" in name for name in predictor.names)
    signals = [predictor.names.index(f"tau{axis}_Nm") for axis in range(1, model.axis_count + 1)]
    left, more = (
        (predictor.measured - predictor.predict(lay.pack(each)[None])[0])[signals][:, predictor.rows].std(axis=1)
        for each in (right, model)
    )
    assert left == pytest.approx(TORQUE_NM, rel=0.05)
    assert more.max() > 1.5 * TORQUE_NM


def test_a_force_that_a_bench_has_told_a_carriage_is_no_effect(tmp_path: Path) -> None:
    steps = (
        "steps=[{ramp: {path: line_speed_m_s, to: 1.0, duration_s: 1.0}}, {hold: {until_s: 2.0}}, {ramp: {path: "
        "position_control.dancer.force.set_point_N, to: 90.0, duration_s: 1.0}}, {hold: {until_s: 5.1}}]"
    )
    changes = ("controllers.dancer_position.force={}", "hardware.sensors.torque_noise_Nm=0.05", "criteria=[]", steps)
    given = load_with_overrides(DANCER, bus=f"embedded:{tmp_path.name}", changes=changes)
    outcome = run_experiment(given, tmp_path / "run", participants=Participants.IN_PROCESS)
    model = machine(DANCER)
    data = measured_from(read_recording(outcome.folder.recording), model, "the bench")
    assert np.ptp(data.forces_N["dancer"]) > 20.0

    def left_Nm(data: Measured) -> float:
        predictor = choice(model, data, emulation_of(given.config)).predictor
        rest = predictor.measured - predictor.predict(lay.pack(model)[None])[0]
        return float(rest[predictor.names.index("tau2_Nm"), predictor.rows].std())

    assert left_Nm(data) == pytest.approx(TORQUE_NM, rel=0.06)
    assert left_Nm(replace(data, forces_N={})) > 2.0 * TORQUE_NM


@pytest.mark.parametrize(
    ("config", "effect", "station", "value"),
    [
        (DANCER, "carriage_viscous_friction", "dancer", 60.0),
        *slow(
            (DANCER, "carriage_coulomb_friction", "dancer", 4.0),
            (DANCER, "carriage_force", "dancer", -8.0),
            (DANCER, "carriage_spring", "dancer", 300.0),
            (DANCER, "idler_viscous_friction", "guide", 1.0),
            (DANCER, "idler_coulomb_friction", "dancer", 2.0),
            (WINDING, "carriage_coulomb_friction", "store", 15.0),
            (WINDING, "carriage_force", "store", 20.0),
            (WINDING, "idler_viscous_friction", "store", 0.5),
            (WINDING, "reel_radius", "unwinder", 0.005),
            (WINDING, "reel_radius", "rewinder", -0.005),
        ),
    ],
)
def test_an_effect_of_a_station_is_named_with_the_station_and_its_size(
    config: Path, effect: str, station: str, value: float
) -> None:
    data = measured_from(recorded(config, of_station(effect, station, value)), machine(config), "the bench")
    found = searched(config, data)
    (term,) = found.fit.terms
    assert term.place == Place(effect, None, station)
    assert term.coordinates()[0] == pytest.approx(value, rel=0.05)


def test_nothing_is_named_of_a_line_that_is_the_model() -> None:
    data = measured_from(recorded(DANCER), machine(DANCER), "the bench")
    assert searched(DANCER, data).fit.terms == []


def test_recordings_that_no_bench_has_made_are_refused_in_one_line() -> None:
    recording = recorded(DANCER)
    without = Recording({name: values for name, values in recording.channels.items() if name != "tau_load_cmd_Nm"})
    with pytest.raises(UnusableInputError, match="expected a recording of a bench that emulates it"):
        measured_from(without, machine(DANCER), "a stand")
    under_way = Recording({name: values[400:] for name, values in recording.channels.items()})
    with pytest.raises(UnusableInputError, match="in motion at the first row"):
        measured_from(under_way, machine(DANCER), "a bench")


def test_an_effect_needs_a_station_that_can_have_it() -> None:
    with pytest.raises(ValueError, match="lacks its station, expected the name of one: accumulator, dancer"):
        EffectEntry(effect="carriage_force", parameters={"force_N": 1.0})
    with pytest.raises(ValueError, match="of station guide, expected dancer"):
        machine(DANCER).with_effects(of_station("carriage_force", "guide", 1.0))
    with pytest.raises(ValueError, match="with station dancer, expected none"):
        EffectEntry(effect="elasticity_shift", station="dancer", parameters={"relative_change": 0.1})


@pytest.mark.slow
def test_the_command_names_what_a_shipped_config_hides(tmp_path: Path) -> None:
    done = hilbench("diagnose", CONFIGS / "hidden_dancer.yaml", "--json", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["effects"]
    assert (found["effect"], found["station"], found["axis"]) == ("carriage_coulomb_friction", "dancer", None)
    low, high = found["parameters"]["force_N"]["ci95"]
    assert low <= 6.0 <= high


def test_a_run_is_judged_by_what_the_twin_tells_of_each_section() -> None:
    t = np.linspace(0.0, 1.0, 100)
    channels = {f"F{span}_true_N": 80.0 + 0.0 * t for span in (1, 2, 3)} | {"t_s": t, "v1_cmd_m_s": 1.0 + t}
    channels |= {"F1_sim_N": 81.0 + 0.0 * t, "F3_sim_N": 79.5 + 0.0 * t, "v2_cmd_m_s": 1.0 + t}
    channels["tau2_residual_Nm"] = np.where(np.arange(100) % 2, 0.1, -0.1)
    found = {figure.name: figure.value for figure in figures_of_line(Recording(channels))}
    assert found == {
        "torque_residual_axis2_rms_Nm": pytest.approx(0.1),
        "tension1_deviation_mean_N": pytest.approx(1.0),
        "tension3_deviation_mean_N": pytest.approx(-0.5),
    }
