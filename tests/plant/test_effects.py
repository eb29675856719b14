"""Each effect: neutral changes nothing, and otherwise does what its law says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from hilbench.plant.effect import Effect, EffectPlace, MachineKind
from hilbench.plant.effects import EFFECTS, effect_problem, effects_of, find_effect
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line import offline
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.line_follower import LineFollower
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.sizes import machine_sizes

from .models import effect, line_of, lone_axis, model

ROW_S = 0.002


def run(parameters: ModelParameters, rows: int = 400, speed: float = 1.0) -> offline.Simulation:
    """A ramp to `speed` and a reversal, with a speed difference between the rollers."""
    p = lay.pack(parameters)
    t = np.arange(rows) * ROW_S
    v = speed * np.sin(2.0 * np.pi * t / 0.8)
    n = parameters.axis_count
    commands = np.column_stack([v * (1.0 + 2e-5 * i) for i in range(n)])
    boundary = np.tile([parameters.upstream_strain, parameters.boundary.downstream_tension_N], (rows, 1))
    return offline.simulate(p, offline.start_state(p, parameters), commands, boundary, ROW_S)


def usual(item: Effect) -> dict[str, float]:
    """Every parameter at its usual size on the demonstrator, onsets early."""
    sizes = machine_sizes(model(), 2, top_speed_m_s=4.0)
    values = {q.name: min(max(q.size.on(sizes), q.lower), q.upper) for q in item.parameters}
    return values | ({"time_s": 0.1} if "time_s" in values else {})


def entries(neutral: bool) -> list[dict[str, Any]]:
    result = []
    for item in effects_of(MachineKind.WEB_LINE):
        values = usual(item)
        if neutral:
            values |= {name: item.parameter(name).neutral for name in item.strength}
        result.append(effect(item.id, 2 if item.per_axis else None, **values))
    return result


@pytest.mark.parametrize("entry", entries(neutral=True), ids=lambda e: e["effect"])
def test_neutral_effect_is_bit_identical_to_none(entry: dict[str, Any]) -> None:
    plain, neutral = run(model()), run(model(entry))
    for name in ("x_m", "v_m_s", "tau_Nm", "F_N", "strain", "state"):
        assert np.array_equal(getattr(plain, name), getattr(neutral, name))


@pytest.mark.parametrize("entry", entries(neutral=False), ids=lambda e: e["effect"])
def test_effect_shows(entry: dict[str, Any]) -> None:
    assert not np.array_equal(run(model()).tau_Nm[:, 1], run(model(entry)).tau_Nm[:, 1])


ROWS = [row for kind in MachineKind for row in effects_of(kind)]


@pytest.mark.parametrize("item", ROWS, ids=lambda e: e.id)
def test_strength_parameters_exist_and_bounds_hold_the_neutral_value(item: Any) -> None:
    assert {q.name for q in item.parameters} >= set(item.strength) != set()
    assert item.probe is None or item.probe.parameter in {q.name for q in item.parameters}
    for q in item.parameters:
        assert q.problem(q.neutral) is None
        assert q.problem(float("nan")) is not None


def lone(torque: float, rows: int, *effects: dict[str, Any], v0: float = 0.0, then: float | None = None) -> Any:
    parameters = lone_axis(*effects)
    p = lay.pack(parameters)
    layout = lay.Layout.of(p)
    start = offline.start_state(p, parameters)
    layout.y(start)[1] = layout.y(start)[3] = v0
    lay.refresh_modes(p, start)
    commands = np.full((rows, 1), torque)
    if then is not None:
        commands[rows // 2 :] = then
    return offline.simulate(p, start, commands, np.zeros((rows, 2)), ROW_S, MotorMode.TORQUE)


def test_dry_friction_stops_the_roller_where_energy_says_and_holds_it() -> None:
    result = lone(0.0, 400, effect("coulomb_friction", 1, force_N=6.0), v0=1.0)
    assert result.v_m_s[-1, 0] == 0.0  # exactly: no chatter
    assert result.x_m[-1, 0] == pytest.approx(3.0 * 1.0**2 / (2 * 6.0), abs=1e-12)


def test_roller_sticks_below_and_slides_above_the_breakaway_force() -> None:
    held = lone(5.9, 100, effect("coulomb_friction", 1, force_N=6.0))
    assert np.all(held.x_m == 0.0)
    free = lone(6.6, 101, effect("coulomb_friction", 1, force_N=6.0))
    assert free.v_m_s[-1, 0] == pytest.approx((6.6 - 6.0) / 3.0 * 0.2, abs=1e-12)


def test_stribeck_force_adds_to_breakaway_and_fades_with_speed() -> None:
    entries = (
        effect("coulomb_friction", 1, force_N=3.0),
        effect("stribeck_friction", 1, force_N=3.0, speed_m_s=0.1),
    )
    assert np.all(lone(5.9, 100, *entries).x_m == 0.0)
    fast = lone(3.0, 101, *entries, v0=2.0)
    assert fast.v_m_s[-1, 0] == pytest.approx(2.0, abs=1e-9)


def test_reversal_under_dry_friction_is_located_in_time() -> None:
    # 9 N against the motion and 6 N of friction brake 1 m/s in 0.2 s; then 3 N net accelerate backwards.
    result = lone(-9.0, 201, effect("coulomb_friction", 1, force_N=6.0), v0=1.0)
    assert result.v_m_s[-1, 0] == pytest.approx(-(9.0 - 6.0) / 3.0 * 0.2, abs=1e-9)


def test_backlash_turns_the_motor_alone_and_then_shares_momentum() -> None:
    gap, torque = 0.02, 4.0
    result = lone(torque, 101, effect("backlash", 1, gap_rad=gap))
    free = torque / 1.0  # the motor's 1 kg alone
    touch = np.sqrt(2 * (gap / 2) / free)
    shared = free * touch * 1.0 / 3.0
    t = 0.2
    expected = shared + torque / 3.0 * (t - touch)
    assert result.v_m_s[-1, 0] == pytest.approx(expected, abs=1e-8)
    assert result.x_m[-1, 0] == pytest.approx(
        gap / 2 + shared * (t - touch) + torque / 6.0 * (t - touch) ** 2, abs=1e-8
    )


def test_backlash_lets_the_motor_lead_by_the_gap_on_reversal() -> None:
    result = lone(3.0, 200, effect("backlash", 1, gap_rad=0.05), then=-3.0)
    layout = lay.Layout(1, 1, 0)
    y = layout.y(result.state)
    assert y[2] - y[0] == pytest.approx(-0.025, abs=1e-12)


@pytest.mark.parametrize("far_m", [1.0, 13.7, 264.1, 9876.5])
def test_backlash_is_the_same_after_any_distance(far_m: float) -> None:
    """Positions grow and their rounding with them; flanks must go on to part."""
    parameters = model(effect("backlash", 1, gap_rad=0.01), effect("backlash", 2, gap_rad=0.02))
    p, found = lay.pack(parameters), []
    t = np.arange(2000) * ROW_S
    commands = 1.0 + 0.5 * np.sin(2.0 * np.pi * t / 0.37)[:, None] * np.array([1.0, 1.00002])
    boundary = np.tile([parameters.upstream_strain, parameters.boundary.downstream_tension_N], (len(t), 1))
    for moved_m in (0.0, far_m):
        start = offline.start_state(p, parameters)
        start[lay.S_Y : lay.S_Y + 8].reshape(4, 2)[[0, 2]] += moved_m
        found.append(offline.simulate(p, start, commands, boundary, ROW_S).tau_Nm)
    assert np.ptp(found[0]) > 1.0
    assert np.sqrt(np.mean((found[1] - found[0]) ** 2)) < 1e-4 * np.ptp(found[0])


def test_backlash_under_velocity_control_stays_bounded_at_the_sample_time() -> None:
    parameters = model(effect("backlash", 2, gap_rad=0.02))
    result = run(parameters, 2000)
    plain = run(model(), 2000)
    assert np.all(np.isfinite(result.state))
    assert np.abs(result.x_m - plain.x_m).max() < 5 * 0.02 / 25.0


def test_the_modulus_that_acts_is_told_with_what_effects_make_of_it() -> None:
    drift = effect("elasticity_drift", rate_per_s=0.5), effect("elasticity_shift", relative_change=-0.2)
    line = Line(model(*drift))
    line.step(0.4)
    assert line.elasticity_factor(1) == pytest.approx(0.8 * 1.2)
    plain = Line(model())
    plain.step(0.4)
    assert plain.elasticity_factor(1) == 1.0


def test_measured_torque_is_late_by_the_delay_and_interpolated() -> None:
    rows = 100
    commands = np.column_stack([0.5 * np.sin(40.0 * np.arange(rows) * ROW_S)])
    p = lay.pack(lone_axis())
    start = offline.start_state(p, lone_axis())
    zeros = np.zeros((rows, 2))
    plain = offline.simulate(p, start, commands, zeros, ROW_S, MotorMode.TORQUE).tau_Nm[:, 0]
    for delay, expected in ((0.004, plain[8:-2]), (0.0035, 0.5 * (plain[8:-2] + plain[9:-1]))):
        late = lay.pack(lone_axis(effect("torque_delay", 1, delay_s=delay)))
        shown = offline.simulate(late, start, commands, zeros, ROW_S, MotorMode.TORQUE).tau_Nm[:, 0]
        np.testing.assert_allclose(shown[10:], expected, rtol=0, atol=1e-14)


def test_offset_shifts_only_the_measurement() -> None:
    plain, shifted = run(model()), run(model(effect("torque_offset", 2, offset_Nm=0.2)))
    assert np.array_equal(plain.x_m, shifted.x_m)
    np.testing.assert_allclose(shifted.tau_Nm[:, 1] - plain.tau_Nm[:, 1], 0.2, atol=1e-12)


def test_scale_lowers_the_measured_torque_at_equal_load() -> None:
    scaled = standing(model(effect("torque_scale", 2, relative_change=0.25)))
    assert scaled.outputs()["tau2_Nm"] * 1.25 == pytest.approx((scaled.tension_N[0] - 70.0) / 25.0, abs=1e-9)


def standing(parameters: ModelParameters) -> Line:
    ports = [MotorPort(mode=MotorMode.VELOCITY) for _ in range(parameters.axis_count)]
    line = Line(parameters, ports)
    for _ in range(2000):
        line.step(0.002)
    return line


def test_ripples_of_several_orders_add_up() -> None:
    entries = [effect("torque_ripple", 1, amplitude_Nm=a, order=n, phase_rad=f) for a, n, f in RIPPLES]
    one = lone(0.0, 2, *entries)
    expected = sum(a * np.sin(f) for a, _, f in RIPPLES) / 3.0
    assert one.v_m_s[1, 0] == pytest.approx(expected * ROW_S, rel=1e-3)


RIPPLES = [(0.5, 1.0, 0.4), (0.25, 2.0, 1.1), (0.1, 7.0, -0.3)]


def test_web_is_conserved_in_a_line_whose_ends_stand_still() -> None:
    # Friction holds the first and the last roller; the middle one moves web to and fro between the spans.
    held = [effect("coulomb_friction", axis, force_N=1e4) for axis in (1, 3)]
    parameters = line_of(3, *held)
    p = lay.pack(parameters)
    layout = lay.Layout.of(p)
    start = offline.start_state(p, parameters)
    commands = np.zeros((500, 3))
    commands[:, 1] = 0.6 * np.sin(12.0 * np.arange(500) * ROW_S)
    boundary = np.tile([parameters.upstream_strain, 70.0], (500, 1))
    result = offline.simulate(p, start, commands, boundary, ROW_S, MotorMode.TORQUE)
    before, after = layout.y(start)[12:14].sum(), layout.y(result.state)[12:14].sum()
    assert np.ptp(result.F_N[:, 0]) > 1.0
    assert after == pytest.approx(before, abs=1e-13)


@settings(max_examples=25, deadline=None)
@given(
    speeds=st.lists(st.floats(-4.0, 4.0), min_size=4, max_size=12),
    difference=st.floats(-5e-3, 5e-3),
    which=st.sampled_from([item.id for item in effects_of(MachineKind.WEB_LINE)]),
)
def test_no_web_pushes_and_nothing_runs_away(speeds: list[float], difference: float, which: str) -> None:
    item = find_effect(which)
    parameters = model(effect(which, 2 if item.per_axis else None, **usual(item)))
    p = lay.pack(parameters)
    v = np.repeat(speeds, 50)
    commands = np.column_stack([v, v * (1 + difference)])
    boundary = np.tile([parameters.upstream_strain, 70.0], (len(v), 1))
    result = offline.simulate(p, offline.start_state(p, parameters), commands, boundary, ROW_S)
    assert result.F_N.min() >= 0.0
    assert np.all(np.isfinite(result.state))
    assert np.abs(result.tau_Nm[:, 0]).max() <= 9.0


def test_variants_in_one_call_equal_single_calls() -> None:
    variants = [model(), model(effect("web_slip", creep_per_N=2e-6)), model(effect("coulomb_friction", 2, force_N=4.0))]
    rows = 300
    commands = np.column_stack([np.linspace(0.0, 1.0, rows)] * 2)
    boundary = np.tile([variants[0].upstream_strain, 70.0], (rows, 1))
    packed = np.stack([lay.pack(v) for v in variants])
    start = offline.start_state(packed[0], variants[0])
    for order in ([0, 1, 2], [2, 0, 1]):
        together = offline.simulate(packed[order], start, commands, boundary, ROW_S)
        for place, variant in enumerate(order):
            alone = offline.simulate(packed[variant], start, commands, boundary, ROW_S)
            assert np.array_equal(together.tau_Nm[place], alone.tau_Nm)
            assert np.array_equal(together.F_N[place], alone.F_N)


def test_time_of_a_step_acts_continuously() -> None:
    def strain_after(time_s: float) -> float:
        return float(run(model(effect("elasticity_step", time_s=time_s, relative_change=0.2)), 60).strain[-1, 0])

    early, middle, late = strain_after(0.05), strain_after(0.0505), strain_after(0.051)
    assert min(early, late) < middle < max(early, late)


UNBALANCE = {"amplitude_Nm": 4.0, "phase_rad": 0.7}


def test_a_roller_out_of_balance_swings_like_a_pendulum() -> None:
    """3·θ'' = T - 2·θ' + A·sin(θ + φ0) on a roller of 1 m and 3 kg at the web, by another solver."""
    entries = effect("unbalance", 1, **UNBALANCE), effect("viscous_friction", 1, coefficient_N_s_per_m=2.0)
    swung = lone(1.5, 2000, *entries)

    def rates(t: float, y: Any) -> list[float]:
        return [y[1], (1.5 - 2.0 * y[1] + 4.0 * np.sin(y[0] + 0.7)) / 3.0]

    t = np.arange(2000) * ROW_S
    expected = solve_ivp(rates, (0.0, t[-1]), [0.0, 0.0], t_eval=t, method="DOP853", rtol=1e-11, atol=1e-12).y
    assert np.ptp(expected[0]) > 0.5
    np.testing.assert_allclose(swung.x_m[:, 0], expected[0], atol=1e-8)
    np.testing.assert_allclose(swung.v_m_s[:, 0], expected[1], atol=1e-8)


def test_unbalance_of_a_geared_roller_is_the_ripple_of_the_motor_that_has_its_angle_and_torque() -> None:
    """Of the roller's angle and torque: through a gear of 5, a ripple of a fifth of the order and of the amplitude."""
    ripple = effect("torque_ripple", 2, amplitude_Nm=0.8, order=0.2, phase_rad=0.7)
    one, other = run(model(effect("unbalance", 2, **UNBALANCE))), run(model(ripple))
    assert np.abs(one.tau_Nm - run(model()).tau_Nm).max() > 0.1
    np.testing.assert_allclose(one.tau_Nm, other.tau_Nm, atol=1e-7)
    np.testing.assert_allclose(one.F_N, other.F_N, atol=1e-5)


def test_a_load_motor_emulates_unbalance_by_the_angle_of_the_roller() -> None:
    plain, unbalanced = (LineFollower(model(*entries)) for entries in ((), (effect("unbalance", 2, **UNBALANCE),)))
    for x_m in (0.03, 0.3, 0.9):
        torques = []
        for web in (plain, unbalanced):
            web.reset((x_m, x_m))
            torques.append(web.web_torque_Nm(2, 1.0))
        assert torques[1] - torques[0] == pytest.approx(4.0 * np.sin(x_m / 0.2 + 0.7) / 5.0)


def test_effects_of_a_roller_are_emulated_only_where_a_load_motor_is() -> None:
    def problem(effect_id: str, axis: int | None, place: EffectPlace) -> str | None:
        return effect_problem(effect_id, axis, place, 3, (2,))

    for effect_id in ("coulomb_friction", "unbalance"):
        assert problem(effect_id, 2, EffectPlace.LOAD) is None
        assert "axis 2, where the load motor is" in str(problem(effect_id, 3, EffectPlace.LOAD))
        assert problem(effect_id, 3, EffectPlace.HARDWARE) is None
        assert "1 to 3" in str(problem(effect_id, 4, EffectPlace.HARDWARE))
    assert "'hardware:'" in str(problem("torque_offset", 2, EffectPlace.LOAD))
    assert "the web is the load model's" in str(problem("elasticity_shift", None, EffectPlace.HARDWARE))
    assert "unknown effect 'friction'" in str(problem("friction", 1, EffectPlace.LOAD))


def test_a_machine_that_turns_has_frictions_in_newton_metres_and_no_web() -> None:
    rotary = {item.id: item for item in effects_of(MachineKind.SERVO_AXIS)}
    assert {"coulomb_friction", "viscous_friction", "inertia_mismatch", "unbalance"} <= rotary.keys()
    assert not {"elasticity_step", "web_slip", "roller_eccentricity"} & rotary.keys()
    units = {q.unit for item in rotary.values() for q in item.parameters}
    assert not {unit for unit in units if unit in ("N", "m", "m/s", "N·s/m")}
    assert find_effect("coulomb_friction", MachineKind.SERVO_AXIS).parameters[0].name == "torque_Nm"
    with pytest.raises(KeyError, match="unknown effect 'web_slip'"):
        find_effect("web_slip", MachineKind.SERVO_AXIS)


@pytest.mark.parametrize(
    ("misspelt", "meant"), [("carriage_sprung", "carriage_spring"), ("coulomb_frction", "coulomb_friction")]
)
def test_who_misspells_an_effect_is_told_what_is_meant(misspelt: str, meant: str) -> None:
    with pytest.raises(KeyError, match=rf", did you mean '{meant}'\? Expected one of .*reel_radius"):
        find_effect(misspelt)


@pytest.mark.parametrize("item", EFFECTS, ids=lambda e: e.id)
def test_a_row_has_all_that_a_search_needs(item: Effect) -> None:
    assert item.shown_by
    names = {q.name for q in item.parameters}
    if item.probe is not None:
        assert item.probe.parameter in names
        assert not item.probe.duration or item.probe.duration in names
    for q in item.parameters:
        assert q.size.on(machine_sizes(model(), 1, top_speed_m_s=4.0)) > 0.0
    if item.at_once is not None:
        sudden = find_effect(item.at_once)
        assert {q.name for q in sudden.parameters} < names
