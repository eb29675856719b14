"""A force on the carriage of an accumulator that is fed forward: what it is, and what it leaves of a reel change."""

from __future__ import annotations

import re
from functools import cache
from math import cos
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from tests.plant.models import DEMONSTRATOR

from hilbench.apps.report.machines.web_line import panels_of
from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.load_model import LoadModel
from hilbench.bench.tasks.web_positions import CarriageForceTask
from hilbench.bench.tasks.web_winding_control import ROUNDED, CarriageForce
from hilbench.errors import UnusableInputError
from hilbench.machine_kinds import machine_part
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.recording import read_recording
from hilbench.results.recover import recover_run
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.check import check_experiment
from hilbench.runs.config import LoadedConfig, load_with_overrides
from hilbench.topology.process_data.web_line import process_data
from hilbench.topology.sample import sample_type
from hilbench.topology.signals import shape_of
from hilbench.topology.web_line_config import forces_ahead

Channels = dict[str, np.ndarray]
CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "line_with_dancer.yaml"
STRANDS, ROLLER_KG, CARRIAGE_KG, TENSION_N = 4, 4.0, 20.0, 80.0
SPEED_M_S, RAMP_S, STOPS_AT_S = 1.0, 1.5, 2.0
STORE = (
    "{type: accumulator, name: store, strands: 4, radius_m: 0.05, inertia_kg_m2: 0.01, mass_kg: 20.0, force_N: 320.0, "
    "viscous_friction_N_s_per_m: 400.0, lower_stop_m: -1.0, upper_stop_m: 1.0}"
)
STEPS = (
    f"steps=[{{ramp: {{path: line_speed_m_s, to: {SPEED_M_S}, duration_s: 1.0}}}}, "
    f"{{hold: {{until_s: {STOPS_AT_S}}}}}, "
    "{step: {path: position_control.store.feed, to: 0.0}}, {hold: {duration_s: 1.1}}]"
)
ACCUMULATOR = (
    "machine.web.span_length_m=[1.5, 1.5, 1.5, 2.5, 2.0, 3.0]",
    f"machine.stations.1={STORE}",
    "load.measured=[store]",
    "controllers={store_position: {kind: position, station: store, feed_ramp_s: 1.5, force: {}}, "
    "outfeed_tension: {span: 5, set_point_N: 80.0, bandwidth_rad_per_s: 4.0}}",
    "criteria=[]",
    STEPS,
)
STAYS = "controllers.store_position.force=null"
SHORTER = ("steps.0.ramp.duration_s=0.3", "steps.1.hold.until_s=0.5", "steps.3.hold.duration_s=0.5")


def line(folder: Path, *changes: str) -> LoadedConfig:
    return load_with_overrides(CONFIG, bus=f"embedded:{folder.name}", changes=(*ACCUMULATOR, *changes))


def run(given: LoadedConfig, folder: Path, how: Participants = Participants.IN_PROCESS) -> RunOutcome:
    return run_experiment(given, folder / how.name, participants=how)


def channels(outcome: RunOutcome) -> Channels:
    assert outcome.result.faults == []
    return {name: np.asarray(values) for name, values in read_recording(outcome.folder.recording).channels.items()}


@cache
def change_of_reels(*changes: str) -> Channels:
    folder = Path(mkdtemp())
    return channels(run(line(folder, *changes), folder))


def stopping(found: Channels) -> np.ndarray:
    """Rows in which what comes in loses its speed evenly."""
    since_s = found["t_s"] - STOPS_AT_S
    return (since_s > 0.3 * RAMP_S) & (since_s < 0.7 * RAMP_S)


def at_speed(found: Channels) -> np.ndarray:
    return (found["t_s"] > STOPS_AT_S - 0.5) & (found["t_s"] < STOPS_AT_S)


def changed_N(found: Channels, span: int) -> float:
    tension_N = found[f"F{span}_true_N"]
    return float(np.mean(tension_N[stopping(found)]) - np.mean(tension_N[at_speed(found)]))


#: What the ends of the accumulator come to differ by: 3 rollers, on average at half the acceleration.
APART_N = ROLLER_KG * SPEED_M_S / RAMP_S / (1.0 - ROUNDED) * (STRANDS - 1) / 2.0


# -- the force by itself ---------------------------------------------------------------------------------------------

FRICTION = {"coulomb_friction_N": 6.0, "roller_coulomb_friction_N": 0.3, "roller_viscous_friction_N_s_per_m": 0.2}
OF_STORE = {
    "type": "accumulator", "name": "store", "strands": STRANDS, "radius_m": 0.05, "inertia_kg_m2": 0.01,
    "mass_kg": CARRIAGE_KG, "force_N": 320.0, "viscous_friction_N_s_per_m": 400.0, "spring_N_per_m": 70.0, **FRICTION,
}  # fmt: skip


def model_of(station: dict[str, Any], effects: list[dict[str, Any]] | None = None) -> ModelParameters:
    stations = [{"type": "roller"}, station, {"type": "roller"}]
    return ModelParameters.model_validate({**DEMONSTRATOR, "stations": stations, "effects": effects or []})


def balanced(model: ModelParameters, ahead: CarriageForce, position_m: float, *speeds: float) -> np.ndarray:
    """Tensions of the strands that the force makes, by the balances of rollers and carriage, all at once."""
    (carriage,), before, behind, before_m_s2, behind_m_s2 = model.carriages, *speeds
    station, n = carriage.station, carriage.station.strand_count
    gain = cos(position_m / station.arm_length_m) if station.arm_length_m else 1.0
    roller_kg = station.inertia_kg_m2 / station.radius_m**2
    rows, right = np.zeros((n, n)), np.zeros(n)
    for j in range(1, n):  # m·a = F_behind - F_before - R
        v = before + (behind - before) * j / n
        a = before_m_s2 + (behind_m_s2 - before_m_s2) * j / n
        rows[j - 1, [j - 1, j]] = -1.0, 1.0
        resisting = station.roller_coulomb_friction_N * np.sign(v) + station.roller_viscous_friction_N_s_per_m * v
        right[j - 1] = roller_kg * a + resisting
    v, a = ((one - other) / n / gain for one, other in ((before, behind), (before_m_s2, behind_m_s2)))
    pushed_N = ahead.force_N(TENSION_N, *speeds, position_m)
    pushed_N += sum(each.parameters["force_N"] for each in model.effects if each.effect == "carriage_force")
    pushed_N -= station.spring_N_per_m * (position_m - station.spring_rest_m)
    resisting = station.viscous_friction_N_s_per_m * v + station.coulomb_friction_N * np.sign(v)
    rows[n - 1], right[n - 1] = gain, pushed_N - resisting - station.mass_kg * a
    return np.linalg.solve(rows, right)


@pytest.mark.parametrize(
    "model",
    [
        model_of(OF_STORE),
        model_of(OF_STORE, [{"effect": "carriage_force", "station": "store", "parameters": {"force_N": -9.0}}]),
        model_of(
            {key: value for key, value in OF_STORE.items() if key != "strands"} | {"type": "dancer", "arm_m": 0.4}
        ),
    ],
    ids=["accumulator", "with a force that the model adds", "dancer on an arm"],
)
@pytest.mark.parametrize("speeds", [(0.0, 0.0, 0.0, 0.0), (3.0, 2.0, -1.5, 0.0), (0.5, 2.0, 0.8, 0.2)])
def test_the_force_makes_the_tension_that_is_wanted_and_shares_what_the_ends_differ_by(
    model: ModelParameters, speeds: tuple[float, ...]
) -> None:
    (carriage,), behind = model.carriages, speeds[1]
    for takes in (0.0, 0.5, 1.0):
        ahead = CarriageForce(model, carriage, behind_takes=takes)
        evenly_N, moving_N = (balanced(model, ahead, 0.1, *each) for each in ((behind, behind, 0.0, 0.0), speeds))
        assert evenly_N[-1] == pytest.approx(TENSION_N)
        apart_N = moving_N[-1] - moving_N[0] - (evenly_N[-1] - evenly_N[0])
        assert moving_N[-1] - TENSION_N == pytest.approx(takes * apart_N, abs=1e-9)
        assert moving_N[0] - evenly_N[0] == pytest.approx((takes - 1.0) * apart_N, abs=1e-9)


class Turns:
    """An axis that is told a speed."""

    def __init__(self, speed_m_s: float) -> None:
        self.speed_m_s = self.damped_m_s = speed_m_s
        self.speeds = np.full(2, speed_m_s)


# -- on a bench ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_both_ends_of_an_accumulator_share_what_its_rollers_need() -> None:
    found, stays = change_of_reels(), change_of_reels(STAYS)
    for each in (found, stays):
        assert changed_N(each, 1) - changed_N(each, STRANDS) == pytest.approx(APART_N, abs=0.15)
    assert changed_N(found, 1) == pytest.approx(0.5 * APART_N, abs=0.25)
    assert changed_N(found, STRANDS) == pytest.approx(-0.5 * APART_N, abs=0.25)
    assert changed_N(stays, 1) > 0.7 * APART_N


def test_the_end_behind_takes_what_it_is_to_take() -> None:
    found = change_of_reels("controllers.store_position.force={behind_takes: 0.0}")
    assert changed_N(found, STRANDS) == pytest.approx(0.0, abs=0.25)
    assert changed_N(found, 1) == pytest.approx(APART_N, abs=0.25)


def test_the_force_is_recorded_as_it_is_told() -> None:
    found = change_of_reels()
    assert "f_store_cmd_N" not in change_of_reels(STAYS)
    assert np.mean(found["f_store_cmd_N"][at_speed(found)]) == pytest.approx(STRANDS * TENSION_N, abs=0.5)
    # Half of what the ends differ by is taken off each strand's pull behind; strand k of 4 has the rollers' behind it.
    lost_m_s2 = APART_N / ROLLER_KG / 1.5
    needs_N = ROLLER_KG * lost_m_s2 * np.array([3.0, 2.0, 1.0]) / 4.0
    strands_N = TENSION_N - 0.5 * APART_N + np.array([needs_N[k:].sum() for k in range(STRANDS)])
    rows = stopping(found)
    carriage_m_s = np.mean(found["v1_m_s"][rows] - SPEED_M_S) / STRANDS
    expected_N = strands_N.sum() - CARRIAGE_KG * lost_m_s2 / STRANDS + 400.0 * carriage_m_s
    assert np.mean(found["f_store_cmd_N"][rows]) == pytest.approx(expected_N, abs=0.3)


def test_the_twin_is_told_the_force_and_its_line_follows_it(tmp_path: Path) -> None:
    given = line(tmp_path).config
    told = process_data(given.shape)
    assert [(each.name, each.index, each.sub) for each in told.boundary[1].signals] == [
        ("x_store_meas_m", 0x6413, 3),
        ("f_store_cmd_N", 0x6413, 9),
    ]
    found = change_of_reels("controllers.store_position.force={set_point_N: 90.0}")
    steady = at_speed(found)
    assert np.mean(found["F1_true_N"][steady]) == pytest.approx(90.0, abs=0.3)
    for rows in (steady, stopping(found)):
        assert np.mean((found["F1_sim_N"] - found["F1_true_N"])[rows]) == pytest.approx(0.0, abs=0.1)


def test_a_set_point_of_the_tension_acts_on_the_force_which_the_cylinder_bounds(tmp_path: Path) -> None:
    path = "position_control.store.force.set_point_N"
    given = line(tmp_path, "controllers.store_position.force={limit_N: 350.0}").config
    with Bench(given, participants=Participants.IN_PROCESS) as bench:
        found = []
        for tension_N in (80.0, 85.0, 90.0):
            bench.set(path, tension_N)
            bench.run(0.03)
            found.append((bench.get(path), bench.last.f_store_cmd_N))
    assert [tension_N for tension_N, _ in found] == [80.0, 85.0, 90.0]
    assert [force_N for _, force_N in found] == pytest.approx([320.0, 340.0, 350.0], abs=0.5)
    assert found[-1][1] == 350.0


def test_a_cylinder_never_pulls(tmp_path: Path) -> None:
    """A carriage that is to fall by 0.25 m/s at once would have to be pulled down: 100 N by its friction alone."""
    given = line(tmp_path, "controllers.store_position.force={set_point_N: 10.0}").config
    sample = sample_type(given.signals)()
    state = BenchState(given.cycle_time_s, sample, lambda _: None, lambda _: None)
    control = machine_part(given.machine.kind, "tasks")(given, state).control
    (task,) = (each for each in control if isinstance(each, CarriageForceTask))
    (carriage,), (force,) = given.web_line.carriages, forces_ahead(given.controllers.values()).values()
    falling = CarriageForceTask(force, given.web_line, carriage, 1, Turns(0.0), Turns(SPEED_M_S), state)
    for each, expected_N in ((task, 40.0), (falling, 0.0)):
        outputs: dict[str, float] = {}
        for _ in range(100):
            each.before(sample, outputs)
        assert sample.f_store_cmd_N == outputs["f_store_cmd_N"] == pytest.approx(expected_N)


def test_while_the_line_is_brought_to_rest_the_force_has_what_that_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = line(tmp_path, "controllers.store_position.force={behind_takes: 0.0}").config
    set_value, behind_N, told_N = LoadModel.set_value, list[float](), list[float]()

    def told(self: LoadModel, name: str, value: float) -> None:
        set_value(self, name, value)
        behind_N.append(self.machine.outputs()[f"F{STRANDS}_N"])
        told_N.append(value)

    monkeypatch.setattr(LoadModel, "set_value", told)
    running = 0

    def interrupted() -> None:
        nonlocal running
        with Bench(given, participants=Participants.IN_PROCESS) as bench:
            bench.ramp("line_speed_m_s", SPEED_M_S, duration_s=1.0)
            bench.run(1.0)
            running = len(told_N)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    # All rollers lose their speed alike; that behind strand k takes it off the strands before it.
    stops_m_s2 = given.quick_stop_per_s2 * SPEED_M_S
    needs_N = ROLLER_KG * stops_m_s2 * (1.0 + 2.0 + 3.0)
    assert needs_N > 30.0
    stopping = slice(running + 30, running + round(0.8 * SPEED_M_S / stops_m_s2 / given.cycle_time_s))
    assert np.mean(told_N[stopping]) - STRANDS * TENSION_N == pytest.approx(needs_N, rel=0.1)
    assert np.mean(behind_N[stopping]) == pytest.approx(TENSION_N, abs=1.0)


@pytest.mark.slow
def test_a_reel_change_of_a_winding_line_leaves_its_tensions_within_1_percent(tmp_path: Path) -> None:
    """An unwinder before the accumulator; 2.2 % behind it where the force stays."""
    ahead = ("controllers.store_position.force={}",)
    given = load_with_overrides(CONFIG.with_name("winding_line.yaml"), bus=f"embedded:{tmp_path.name}", changes=ahead)
    result = run(given, tmp_path).result
    assert result.faults == []
    assert max(row.value or 100.0 for row in result.criteria) < 1.0


@pytest.mark.slow
def test_processes_record_the_bits_of_one_process_and_frames_recover_them(tmp_path: Path) -> None:
    given = line(tmp_path, *SHORTER)
    folder = run(given, tmp_path, Participants.STARTED).folder
    apart, together = read_recording(folder.recording), channels(run(given, tmp_path))
    assert [name for name in together if not np.array_equal(np.asarray(apart[name]), together[name], True)] == []
    folder.recording.unlink()
    recover_run(folder)
    again = read_recording(folder.recording)
    different = [name for name in together if not np.array_equal(np.asarray(again[name]), together[name], True)]
    assert all(name.endswith("_cmd_m_s") for name in different)  # in whole units of the drives


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (("controllers.store_position.force.behind_takes=1.5",), "expected: 1 at most"),
        (("controllers.store_position.force.limit_N=-1.0",), "expected: more than 0"),
        (("controllers.store_position.force.set_point_N=0.0",), "expected: more than 0"),
        (
            ("controllers.store_position.force.limit_N=300.0",),
            "a 'force' of 'store' from 0 to 300 N for a tension of 80 N, which takes 320 N",
        ),
        (
            ("machine.stations.1.force_N=0.0",),
            "'set_point_N' in the 'force' of 'store', or a 'force_N' of the machine that keeps a tension, not 0 N",
        ),
        (
            ("steps.2.step={path: position_control.store.force.set_point_N, to: -1.0}",),
            "expected: a number from 0 to 100000 N",
        ),
        ((STAYS, "steps.2.step.path=position_control.store.force.set_point_N"), "a quantity of a web_line"),
    ],
)
def test_a_force_that_can_not_be_told_is_refused_in_one_line(
    tmp_path: Path, changes: tuple[str, ...], said: str
) -> None:
    with pytest.raises(UnusableInputError, match=said) as refused:
        check_experiment(line(tmp_path, *changes))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        # The carriage falls with 1/4 m/s against 400 N·s/m, which holds 100 N of 80 N.
        (("controllers.store_position.force={set_point_N: 20.0}",), r"asks for -2\d\.\d+ N .* never pulls"),
        (
            (
                "controllers.store_position.force={limit_N: 325.0, behind_takes: 0.0}",
                "steps.2={ramp: {path: line_speed_m_s, to: 0.0, duration_s: 0.5}}",
            ),
            r"asks for 368 N .* has 325 N",  # 4 kg by 2 m/s² of one, two and three strands, beside 320 N
        ),
    ],
)
def test_the_check_tells_what_a_cylinder_does_not_have(tmp_path: Path, changes: tuple[str, ...], said: str) -> None:
    (warning,) = check_experiment(line(tmp_path, *changes)).warnings
    assert re.search(said, warning)
    assert check_experiment(line(tmp_path)).warnings == []


def test_the_report_shows_the_force() -> None:
    pictures = panels_of(shape_of(change_of_reels())).pictures
    assert [picture.title for picture in pictures][-1] == "Forces on the carriages"
