"""Idlers, dancers, accumulators and reels in a line: against DOP853, closed forms and what must be conserved."""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from hilbench.apps.cli.model_option import model_from
from hilbench.errors import UnusableInputError
from hilbench.plant.fmu.export.web_line import exported_load
from hilbench.plant.model_file import write_model
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.modes import natural_frequencies_rad_s, needed_substeps
from hilbench.plant.web_line.parameters import ModelParameters, load_model

from .line_equations import Carriage, LineEquations, Roller
from .models import DEMONSTRATOR, effect

STIFFNESS_N = 8.7e9 * 0.5 * 65e-6
IDLER = {"radius_m": 0.05, "inertia_kg_m2": 0.0025}
DRIVEN = {"type": "roller"}
DANCER = {"type": "dancer", "name": "dancer", **IDLER, "mass_kg": 5.0, "force_N": 160.0}
ACCUMULATOR = {"type": "accumulator", "name": "store", **IDLER, "mass_kg": 40.0, "force_N": 320.0, "strands": 4}
#: So heavy that a roller stays where it is.
HELD_KG_M2 = 1e12
ROW_S = 0.002


def line_with(*stations: dict[str, Any], lengths: list[float], **changes: Any) -> ModelParameters:
    web = {**DEMONSTRATOR["web"], "span_length_m": lengths, **changes.pop("web", {})}
    return ModelParameters.model_validate({**DEMONSTRATOR, "web": web, "stations": list(stations), **changes})


def held_dancer(**carriage: Any) -> ModelParameters:
    """A dancer between two rollers that stand still: its roller stays too, as both strands pull alike."""
    rollers = {**DEMONSTRATOR["rollers"], "inertia_kg_m2": HELD_KG_M2}
    stations = (DRIVEN, {**DANCER, **carriage}, DRIVEN)
    return line_with(*stations, lengths=[0.5, 0.5], rollers=rollers)


def strand_N_per_m() -> float:
    """Of a strand of 0.5 m at its first strain: F = E·S·(L + z - m)/m."""
    return STIFFNESS_N / (0.5 / (1.0 + 80.0 / STIFFNESS_N))


def driven_by(line: ModelParameters, torques_Nm: np.ndarray, v0_m_s: float, substeps: int | None) -> list[dict]:
    """Outputs at the start of each row."""
    ports = [MotorPort() for _ in range(line.axis_count)]
    machine = Line(line, ports, substeps=substeps)
    names = [quantity.name for quantity in machine.describe().states]
    speeds = [name for name in names if name.startswith("v") and name.endswith("_m_s")]
    carriages = {f"v_{each.station.name}_m_s" for each in line.carriages}
    machine.set_state({name: v0_m_s for name in speeds if name not in carriages})
    found = []
    for row in torques_Nm:
        found.append(machine.outputs())
        for port, torque in zip(ports, row, strict=True):
            port.mode, port.setpoint = MotorMode.TORQUE, float(torque)
        machine.step(ROW_S)
    return found


DRIVEN_EQUATIONS = Roller(0.2, 1.167 + 25 * 0.001, gear=5.0)
IDLER_EQUATIONS = Roller(0.05, 0.0025)
LINES: dict[str, tuple[ModelParameters, LineEquations]] = {
    "dancer on a guide": (
        line_with(
            DRIVEN,
            {"type": "idler", "name": "guide", **IDLER, "roller_viscous_friction_N_s_per_m": 0.7},
            {**DANCER, "spring_N_per_m": 900.0, "viscous_friction_N_s_per_m": 60.0},
            DRIVEN,
            lengths=[1.0, 0.6, 0.5],
        ),
        LineEquations(
            [DRIVEN_EQUATIONS, Roller(0.05, 0.0025, viscous_N_s_per_m=0.7), IDLER_EQUATIONS, DRIVEN_EQUATIONS],
            [1.0, 0.6, 0.5], STIFFNESS_N, 0.5, 65e-6, 80.0 / STIFFNESS_N, 80.0, 70.0,
            [Carriage((1, 2), 5.0, 160.0, 900.0, 60.0)],
        ),
    ),
    "dancer on an arm": (
        line_with(DRIVEN, {**DANCER, "arm_m": 0.3, "force_N": 150.0}, DRIVEN, lengths=[0.6, 0.5]),
        LineEquations(
            [DRIVEN_EQUATIONS, IDLER_EQUATIONS, DRIVEN_EQUATIONS],
            [0.6, 0.5], STIFFNESS_N, 0.5, 65e-6, 80.0 / STIFFNESS_N, 80.0, 70.0,
            [Carriage((0, 1), 5.0, 150.0, arm_m=0.3)],
        ),
    ),
    "accumulator": (
        line_with(DRIVEN, ACCUMULATOR, DRIVEN, lengths=[1.0, 1.1, 1.2, 1.0]),
        LineEquations(
            [DRIVEN_EQUATIONS, *[IDLER_EQUATIONS] * 3, DRIVEN_EQUATIONS],
            [1.0, 1.1, 1.2, 1.0], STIFFNESS_N, 0.5, 65e-6, 80.0 / STIFFNESS_N, 80.0, 70.0,
            [Carriage((0, 1, 2, 3), 40.0, 320.0)],
        ),
    ),
    "reels": (
        line_with(
            {"type": "unwinder", "core_radius_m": 0.1, "density_kg_m3": 900.0},
            DRIVEN,
            {"type": "rewinder", "core_radius_m": 0.1, "density_kg_m3": 900.0},
            lengths=[1.0, 1.2],
            web={"thickness_m": 2e-3, "youngs_modulus_Pa": 8.7e9 * 65e-6 / 2e-3},
        ),
        LineEquations(
            [
                Roller(0.2, 1.167 + 25 * 0.001, 5.0, winds=-1.0, core_m=0.1),
                DRIVEN_EQUATIONS,
                Roller(0.2, 1.167 + 25 * 0.001, 5.0, winds=1.0, core_m=0.1),
            ],
            [1.0, 1.2], STIFFNESS_N, 0.5, 2e-3, 80.0 / STIFFNESS_N, 80.0, 70.0,
            density_kg_m3=900.0,
        ),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LINES)
def test_a_line_of_stations_solves_the_equations_as_they_are_written(name: str) -> None:
    line, equations = LINES[name]
    t = ROW_S * np.arange(80)
    held_Nm = [-80.0 * 0.2 / 5.0, 0.0, 80.0 * 0.2 / 5.0] if name == "reels" else [0.0, 0.0]
    torques = np.column_stack([0.4 * np.sin(25.0 * t + i) + held for i, held in enumerate(held_Nm)])
    expected = equations.run(torques, ROW_S, 1.5)
    found = driven_by(line, torques, 1.5, substeps=24)
    spans, rollers = range(line.span_count), line.line_rollers
    tensions = np.array([[row[f"F{span + 1}_N"] for span in spans] for row in found])
    names = [f"v{roller.name}_m_s" if roller.axis else f"v_{roller.name}_m_s" for roller in rollers]
    speeds = np.array([[row[name] for name in names] for row in found])
    np.testing.assert_allclose(speeds, expected["speed_m_s"], rtol=0, atol=1e-6)
    np.testing.assert_allclose(tensions, expected["tension_N"], rtol=0, atol=0.02)
    for number, carriage in enumerate(line.carriages):
        positions = [row[f"x_{carriage.station.name}_m"] for row in found]
        np.testing.assert_allclose(positions, expected["position_m"][:, number], rtol=0, atol=1e-8)
    for reel, at in (("unwinder", 0), ("rewinder", 2)) if name == "reels" else ():
        np.testing.assert_allclose([row[f"r_{reel}_m"] for row in found], expected["radius_m"][:, at], atol=1e-9)
        assert np.ptp(expected["radius_m"][:, at]) > 3e-4
    assert np.ptp(expected["tension_N"], axis=0).min() > 1.0
    assert expected["tension_N"].min() > 0.0


@pytest.mark.parametrize("name", LINES)
def test_a_line_takes_as_many_integration_steps_as_its_lightest_roller_needs(name: str) -> None:
    line, _ = LINES[name]
    torques = np.full((100, line.axis_count), 0.2)
    exact, found = (driven_by(line, torques, 1.5, substeps)[-1] for substeps in (24, None))
    for quantity, value in exact.items():
        if quantity.startswith("F"):
            assert found[quantity] == pytest.approx(value, abs=0.2), quantity
    assert needed_substeps(line) == (1 if name == "reels" else needed_substeps(line)) < 24


def test_a_step_of_the_force_on_a_dancer_swings_as_the_damped_oscillator_that_it_is() -> None:
    mass, damping, step_N = 5.0, 200.0, 10.0
    machine = Line(held_dancer(viscous_friction_N_s_per_m=damping), substeps=16)
    machine.set_input("force_dancer_N", 160.0 + step_N)
    stiffness = 2.0 * strand_N_per_m()
    decay = damping / (2.0 * mass)
    omega = sqrt(stiffness / mass - decay**2)
    for number in range(1, 101):
        machine.step(0.001)
        t = 0.001 * number
        swing = exp(-decay * t) * (cos(omega * t) + decay / omega * sin(omega * t))
        assert machine.outputs()["x_dancer_m"] == pytest.approx(step_N / stiffness * (1.0 - swing), abs=1e-9)
    assert natural_frequencies_rad_s(held_dancer())[-1] == pytest.approx(
        max(sqrt(2.0 * STIFFNESS_N / 0.5 / mass), sqrt(2.0 * STIFFNESS_N / 0.5)), rel=1e-6
    )  # the roller is 1 kg at the web


def test_a_force_that_is_told_leaves_what_an_effect_adds_to_it() -> None:
    """A cylinder that pushes with 6 N too little does so whatever it is told."""
    off = {"effect": "carriage_force", "station": "dancer", "parameters": {"force_N": -6.0}}
    model = held_dancer(viscous_friction_N_s_per_m=2000.0).model_dump() | {"effects": [off]}
    machine = Line(ModelParameters.model_validate(model))
    for told_N in (160.0, 200.0):
        machine.set_input("force_dancer_N", told_N)
        machine.step(2.0)
        assert machine.outputs()["F1_N"] == pytest.approx((told_N - 6.0) / 2.0, abs=0.01)


def test_dry_friction_takes_twice_its_force_off_each_swing_of_a_dancer_until_it_sticks() -> None:
    friction_N, step_N = 2.0, 12.0
    machine = Line(held_dancer(coulomb_friction_N=friction_N), substeps=8)
    machine.set_input("force_dancer_N", 160.0 + step_N)
    stiffness, mass = 2.0 * strand_N_per_m(), 5.0
    aim, turn = step_N / stiffness, [0.0]
    while abs(aim - turn[-1]) * stiffness > friction_N:
        side = 1.0 if turn[-1] < aim else -1.0
        turn.append(2.0 * (aim - side * friction_N / stiffness) - turn[-1])
    half_s = pi * sqrt(mass / stiffness)
    places = []
    for _ in range(round((len(turn) + 5) * half_s / 0.001)):
        machine.step(0.001)
        places.append(machine.outputs()["x_dancer_m"])
    for number, expected in enumerate(turn[1:], 1):
        around = places[round((number - 0.5) * half_s / 0.001) : round((number + 0.5) * half_s / 0.001) + 1]
        assert (max if number % 2 else min)(around) == pytest.approx(expected, abs=2e-2 * aim)
    assert machine.outputs()["v_dancer_m_s"] == 0.0
    assert places[-1] == pytest.approx(turn[-1], rel=1e-6)
    assert len(turn) >= 3


def test_a_carriage_stays_at_its_stop_while_it_is_pushed_there_and_leaves_when_it_is_not() -> None:
    machine = Line(held_dancer(upper_stop_m=2e-5, lower_stop_m=-2e-5, coulomb_friction_N=1.0))
    machine.set_input("force_dancer_N", 260.0)
    machine.step(0.05)
    at_stop = machine.outputs()
    assert (at_stop["x_dancer_m"], at_stop["v_dancer_m_s"]) == (2e-5, 0.0)
    pull_N = at_stop["F1_N"] + at_stop["F2_N"]
    assert pull_N == pytest.approx(160.0 + 2.0 * strand_N_per_m() * 2e-5, rel=1e-9)
    machine.set_input("force_dancer_N", pull_N - 0.9)  # the friction holds it
    machine.step(0.05)
    assert machine.outputs()["x_dancer_m"] == 2e-5
    machine.set_input("force_dancer_N", pull_N - 1.1)
    machine.step(0.001)
    assert machine.outputs()["x_dancer_m"] < 2e-5
    machine.set_input("force_dancer_N", 0.0)
    machine.step(0.05)
    assert (machine.outputs()["x_dancer_m"], machine.outputs()["v_dancer_m_s"]) == (-2e-5, 0.0)


def test_an_accumulator_at_speed_has_its_force_shared_out_with_the_friction_of_its_rollers_between() -> None:
    rubs_N = 1.5
    store = {**ACCUMULATOR, "roller_coulomb_friction_N": rubs_N, "viscous_friction_N_s_per_m": 3000.0}
    ports = [MotorPort(), MotorPort()]
    rubbing = {**store, "roller_viscous_friction_N_s_per_m": 0.0}
    machine = Line(line_with(DRIVEN, rubbing, DRIVEN, lengths=[0.4] * 4), ports)
    tensions = []
    for row in range(1500):
        for port in ports:
            port.mode, port.setpoint = MotorMode.VELOCITY, min(0.1 * row, 75.0)
        machine.step(0.004)
        if row >= 1200:
            tensions.append([machine.outputs()[f"F{k}_N"] for k in range(1, 5)])
    mean = np.mean(tensions, axis=0)
    assert np.sum(mean) == pytest.approx(320.0, rel=1e-3)
    np.testing.assert_allclose(np.diff(mean), rubs_N, atol=0.05)


@given(
    radius_m=st.floats(0.15, 0.3),
    thickness_m=st.floats(1e-4, 3e-3),
    turns=st.floats(0.2, 3.0),
)
@settings(max_examples=15, deadline=None)
def test_what_a_reel_has_lost_in_section_is_the_web_that_it_gave(
    radius_m: float, thickness_m: float, turns: float
) -> None:
    stations = ({"type": "unwinder", "core_radius_m": 0.05, "density_kg_m3": 900.0}, DRIVEN)
    rollers = {"radius_m": [radius_m, 0.2], "inertia_kg_m2": 1.0, "gear_ratio": 1.0}
    line = line_with(*stations, lengths=[1.0], rollers=rollers, web={"thickness_m": thickness_m})
    machine = Line(line)
    travel_m = 2.0 * pi * radius_m * turns
    machine.set_state({"x1_m": travel_m})
    radius = machine.outputs()["r_unwinder_m"]
    assert radius == pytest.approx(radius_m - turns * thickness_m)
    # Web given by the turns with their mean radius, times thickness: the ring that is gone.
    given_m = 2.0 * pi * turns * 0.5 * (radius_m + radius)
    assert pi * (radius_m**2 - radius**2) == pytest.approx(given_m * thickness_m, rel=1e-9)


@given(
    mass_kg=st.floats(2.0, 50.0),
    push_N=st.floats(-40.0, 40.0),
    strands=st.integers(2, 6),
    rubs_N=st.sampled_from([0.0, 3.0]),
)
@settings(max_examples=12, deadline=None)
def test_between_rollers_that_stand_no_web_is_lost_and_energy_only_to_friction(
    mass_kg: float, push_N: float, strands: int, rubs_N: float
) -> None:
    store = {**ACCUMULATOR, "mass_kg": mass_kg, "strands": strands, "coulomb_friction_N": rubs_N}
    rollers = {**DEMONSTRATOR["rollers"], "inertia_kg_m2": HELD_KG_M2}
    line = line_with(DRIVEN, {**store, "force_N": 80.0 * strands + push_N}, DRIVEN, lengths=[0.5] * strands,
                     rollers=rollers)  # fmt: skip
    machine = Line(line, substeps=8)
    start = machine.outputs()

    def web_m() -> float:
        now = machine.outputs()
        return sum((0.5 + now["x_store_m"]) / (1.0 + now[f"strain{k}"]) for k in range(1, strands + 1))

    def energy_J() -> float:
        now = machine.outputs()
        moving = 0.5 * mass_kg * now["v_store_m_s"] ** 2 - (80.0 * strands + push_N) * now["x_store_m"]
        rolling = sum(0.5 * now[name] ** 2 for name in now if "_roller" in name)  # 1 kg each at the web
        springs = sum(
            0.5 * now[f"F{k}_N"] * now[f"strain{k}"] * (0.5 + now["x_store_m"]) / (1.0 + now[f"strain{k}"])
            for k in range(1, strands + 1)
        )
        return moving + rolling + springs

    before, energy, least = web_m(), energy_J(), energy_J()
    for _ in range(60):
        machine.step(0.001)
        assert web_m() == pytest.approx(before, rel=1e-12)
        assert energy_J() <= least + 1e-6
        least = min(least, energy_J()) if rubs_N else least
    if not rubs_N:
        assert energy_J() == pytest.approx(energy, abs=1e-6)
    assert machine.outputs()["x1_m"] == pytest.approx(start["x1_m"], abs=1e-9)


def test_a_line_of_stations_goes_on_from_its_state_bit_for_bit_and_a_carriage_is_moved_by_name() -> None:
    line, _ = LINES["accumulator"]
    one, other = (Line(line, [MotorPort(), MotorPort()]) for _ in range(2))
    one.step(0.05)
    other.set_state(one.get_state())
    for each in (one, other):
        each.step(0.05)
    assert one.outputs() == other.outputs()
    before = one.outputs()
    one.set_state({"x_store_m": before["x_store_m"] + 0.01})
    after = one.outputs()
    assert after["x_store_m"] == before["x_store_m"] + 0.01
    assert [after[f"strain{k}"] for k in range(1, 5)] == pytest.approx([before[f"strain{k}"] for k in range(1, 5)])


def test_an_effect_of_an_axis_is_at_the_driven_roller_of_that_number() -> None:
    """Not at the roller that comes as that number: the second axis is behind the dancer."""
    rubbing = line_with(DRIVEN, DANCER, DRIVEN, lengths=[0.5, 0.5], effects=[effect("torque_offset", 2, offset_Nm=0.3)])
    ports = [MotorPort(), MotorPort()]
    machine = Line(rubbing, ports)
    machine.step(0.002)
    assert machine.outputs()["tau2_Nm"] == pytest.approx(0.3)
    assert machine.outputs()["tau1_Nm"] == 0.0
    machine.set_parameter("roller_inertia2_kg_m2", HELD_KG_M2)
    for port in ports:
        port.mode, port.setpoint = MotorMode.TORQUE, 1.0
    before = machine.outputs()
    machine.step(0.01)
    after = machine.outputs()
    assert abs(after["v2_m_s"] - before["v2_m_s"]) < 1e-9
    assert abs(after["v1_m_s"] - before["v1_m_s"]) > 1e-3
    with pytest.raises(ValueError, match="axis 3, expected 1 to 2"):
        machine.set_effect("torque_offset", 3, offset_Nm=0.1)


def test_a_model_of_stations_is_written_and_read_back(tmp_path: Path) -> None:
    for number, (line, _) in enumerate(LINES.values()):
        write_model(tmp_path / f"{number}.yaml", line)
        assert load_model(tmp_path / f"{number}.yaml") == line


REEL = {"type": "unwinder", "core_radius_m": 0.1, "density_kg_m3": 900.0}


@pytest.mark.parametrize(
    ("stations", "lengths", "said"),
    [
        ([DANCER, DRIVEN], [1.0, 1.0], "station 1: the dancer between rollers"),
        ([DRIVEN, DANCER, ACCUMULATOR, DRIVEN], [1.0] * 6, "station 3: a roller before the accumulator"),
        ([DRIVEN, REEL], [1.0], "station 2: an unwinder first"),
        ([DRIVEN, DANCER, DRIVEN, DANCER, DRIVEN], [1.0] * 4, "station 4: names that differ"),
        ([{**REEL, "core_radius_m": 0.3}, DRIVEN], [1.0], "core_radius_m of 0.3, expected at most"),
        ([DRIVEN, {**DANCER, "upper_stop_m": -0.1}, DRIVEN], [1.0, 1.0], "position_m between"),
        ([DRIVEN, DANCER, DRIVEN], [1.0], "span_length_m has 1 values, expected one or 2"),
        ([{"type": "idler", "name": "guide", **IDLER}], [1.0], "at least one driven"),
        ([DRIVEN, {"type": "mangle"}], [1.0], "expected tags"),
    ],
)  # fmt: skip
def test_a_line_that_no_web_can_run_over_is_refused(stations: list[Any], lengths: list[float], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        line_with(*stations, lengths=lengths)


def test_what_knows_driven_rollers_alone_refuses_a_line_of_stations_in_one_line(tmp_path: Path) -> None:
    line, _ = LINES["dancer on an arm"]
    with pytest.raises(ValueError, match="driven rollers alone"):
        exported_load(line)
    write_model(tmp_path / "model.yaml", line)
    with pytest.raises(UnusableInputError, match=r"model\.yaml:\d+: a line with .*driven rollers alone"):
        model_from(tmp_path / "model.yaml")
