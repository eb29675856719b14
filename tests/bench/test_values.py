"""Values that come to a bench, by whichever way: each quantity takes what it may have, and nothing else."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.bench.whole_runs import config
from tests.cli.in_process import hilbench

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.errors import BenchFaultError, UnusableInputError, UnusableValueError
from hilbench.plant.effect import MachineKind
from hilbench.plant.effects import effects_of
from hilbench.runs.config import load
from hilbench.runs.scenario import read_scenario
from hilbench.topology.quantities import (
    LONGEST_S,
    all_paths,
    checked_path,
    checked_value,
    fast_path_places,
    permitted,
    settable_path,
    single_paths,
)
from hilbench.topology.signals import smallest_shapes

PATHS = list(all_paths())
HUGE = 10**400
NO_NUMBERS = [None, "3", "nan", b"1", [1.0], {}, 1j, Decimal(1), np.array([1.0]), float("nan"), float("inf"), -np.inf]
ANYTHING = st.one_of(
    st.floats(),
    st.integers(-(10**40), 10**40) | st.just(HUGE),
    st.fractions(),
    st.sampled_from(NO_NUMBERS),
    st.floats(width=32).map(np.float32),  # a REAL32 of an object
)


def as_number(value: object) -> float | None:
    if not isinstance(value, float | int | Fraction | np.float32) or value is HUGE or not abs(value) < np.inf:
        return None
    return float(value)


def test_every_effect_can_be_set_somewhere_and_where_it_has_no_place_it_is_refused() -> None:
    assert {path.split(".")[2] for path in PATHS if ".effects." in path} == {
        effect.id for kind in MachineKind for effect in effects_of(kind)
    }
    for path in ("hardware.effects.elasticity_drift.rate_per_s", "load.effects.inertia_mismatch.axis2.relative_change"):
        with pytest.raises(ValueError, match=r"load model|hardware"):
            settable_path(path)


@settings(deadline=None, database=None, max_examples=600)
@given(st.sampled_from(PATHS), ANYTHING)
def test_a_quantity_takes_numbers_of_its_range_and_refuses_anything_else_by_name(path: str, value: object) -> None:
    allowed = permitted(path)
    number = as_number(value)
    inside = number is not None and allowed.lower <= number <= allowed.upper
    if allowed.only_ends:
        inside = number in (0.0, 1.0)
    if inside:
        assert checked_value(path, value) == float(value)  # type: ignore[arg-type]
        return
    with pytest.raises(UnusableValueError) as refused:
        checked_value(path, value)
    assert str(refused.value).startswith(f"{path} is ")
    assert str(refused.value).endswith(f", expected {allowed}")


@pytest.mark.parametrize("path", PATHS)
def test_the_ends_of_a_range_are_in_it(path: str) -> None:
    allowed = permitted(path)
    upper = min(allowed.upper, 1e300)  # a time of a step has no end
    for value in (allowed.lower, upper, np.float64(upper)):
        assert checked_value(path, value) == value
    for value in (np.nextafter(allowed.lower, -np.inf), allowed.upper * 1.001 + 1e-9, True):
        if not (allowed.only_ends and value is True):
            with pytest.raises(UnusableValueError):
                checked_value(path, value)


def bench(folder: Path) -> Bench:
    return Bench(config(folder), participants=Participants.IN_PROCESS)


def test_a_script_that_sets_what_is_no_value_is_told_and_its_bench_goes_on_and_stops_in_order(tmp_path: Path) -> None:
    with bench(tmp_path) as running:
        running.ramp("line_speed_m_s", 0.5, 0.2)
        for path in running.config.fast_path_places:
            before = running.get(path)
            for value in [*NO_NUMBERS, -1e9, 1e300]:
                for way in (running.set, running.step, lambda path, value: running.ramp(path, value, 0.1)):
                    with pytest.raises(ValueError, match=f"{path} is |is a switch"):
                        way(path, value)
            assert running.get(path) == before
        running.run(0.05)
        assert not running.events
    assert running.nodes.axes[0].feedback.state.name == "SWITCH_ON_DISABLED"
    assert not running.safe_state_problems
    assert running.fault_time_s is None


def refused(path: Path) -> str:
    """What `check` and `run` say of a config: the same one line, nothing is started."""
    checked = hilbench("check", path)
    ran = hilbench("run", path, "--in-process", "--out", path.parent / "runs")
    assert (checked.returncode, ran.returncode) == (2, 2), (checked, ran)
    assert checked.stderr == ran.stderr
    assert checked.stdout == ran.stdout == ""
    assert not (path.parent / "runs").exists()
    assert checked.stderr.count("\n") == 1
    return checked.stderr


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("load.web.youngs_modulus_Pa", 0.0),
        ("load.web.youngs_modulus_Pa", -8.7e9),
        ("load.web.youngs_modulus_Pa", float("nan")),
        ("load.web.youngs_modulus_Pa", "8.7e9 Pa"),
        ("load.web.youngs_modulus_Pa", True),
        ("load.web.broken", 0.5),
        ("line_speed_m_s", float("inf")),
        ("line_speed_m_s", 1e4),
        ("tension_control.set_point_N", -80.0),
        ("load.effects.elasticity_shift.relative_change", -1.0),
        ("hardware.effects.torque_delay.axis2.delay_s", 0.5),
    ],
)
@pytest.mark.parametrize("kind", ["set", "step", "ramp"])
def test_a_step_to_a_value_that_can_not_be_is_refused_with_its_line_before_the_run(
    tmp_path: Path, kind: str, path: str, value: object
) -> None:
    action = {"path": path, "to": value} | ({"duration_s": 1.0} if kind == "ramp" else {})
    file = config(tmp_path, steps=[{kind: action}])
    line = 1 + next(n for n, text in enumerate(file.read_text().splitlines()) if f"path: {path}" in text)
    said = refused(file)
    if kind == "ramp" and path == "load.web.broken":
        assert "a quantity that can be ramped, 'load.web.broken' is a switch" in said
        return
    assert said.startswith(f"hilbench: {file}:{line + 1}: ")
    assert f"expected: {permitted(path)} for {path}" in said


@pytest.mark.parametrize(
    ("misspelt", "meant"),
    [
        ("line_sped_m_s", "line_speed_m_s"),
        ("position_control.store.setpoint_m", "position_control.store.set_point_m"),
        ("load.effects.coulomb_friction", "load.effects.coulomb_friction.axis2.force_N"),
    ],
)
def test_of_a_misspelt_quantity_those_are_told_that_are_like_it_the_nearest_first(misspelt: str, meant: str) -> None:
    with pytest.raises(UnusableValueError, match=rf"expected one of {re.escape(meant)}\b.*, did you mean '{meant}'\?$"):
        checked_path(misspelt)


def test_where_nothing_is_alike_all_that_can_be_set_is_told() -> None:
    with pytest.raises(UnusableValueError) as refused:
        checked_path("xyz")
    loops = ("position_control.NAME.set_point_m", "position_control.NAME.feed", "load|hardware.effects.ID")
    assert all(path in str(refused.value) for path in (*single_paths(), *loops))


@pytest.mark.parametrize("key", ["duration_s", "rate_per_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan"), 1e9, "soon"])
def test_a_ramp_that_has_no_end_is_refused(tmp_path: Path, key: str, value: object) -> None:
    if key == "rate_per_s" and value == 1e9:
        return  # that fast is a step
    steps = [{"ramp": {"path": "line_speed_m_s", "to": 1.0, key: value}}]
    assert f"'steps.0.ramp.{key}'" in refused(config(tmp_path, steps=steps))


def test_a_ramp_too_slow_to_end_is_a_fault_with_a_result(tmp_path: Path) -> None:
    steps = [{"ramp": {"path": "line_speed_m_s", "to": 1.0, "rate_per_s": 1e-9}}]
    ran = hilbench("run", config(tmp_path, steps=steps), "--in-process", "--out", tmp_path / "runs")
    assert ran.returncode == 3
    assert f"expected at most {LONGEST_S:g} s" in ran.stdout.replace("\n", " ")


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("t_s,load.web.youngs_modulus_Pa\n0,8.7e9\n1,0\n2,\n", "table.csv:3: load.web.youngs_modulus_Pa is '0', expe"),
        ("t_s,ramp:line_speed_m_s\n0,0\n1,1e9\n2,\n", "table.csv:3: ramp:line_speed_m_s is '1e9', expected a number"),
        ("t_s,load.web.broken\n0,0\n1,0.5\n2,\n", "table.csv:3: load.web.broken is '0.5', expected 0 or 1"),
        ("t_s,ramp:load.web.broken\n0,0\n1,1\n2,\n", "table.csv:2: .*'load.web.broken' is a switch"),
        ("t_s,line_speed_m_s\n0,0\n1e9,1\n", "table.csv:3: t_s is 1e.09, expected a time"),
        ("t_s,load.effects.web_slip.creep_per_N\n0,0\n1,-1\n", "table.csv:3: .*expected a number from 0 to 0.01 1/N"),
    ],
)
def test_a_table_with_a_value_that_can_not_be_is_refused_with_its_line(tmp_path: Path, table: str, said: str) -> None:
    (tmp_path / "table.csv").write_text(table)
    with pytest.raises(UnusableInputError, match=said):
        read_scenario(tmp_path / "table.csv")
    assert "table.csv:" in refused(config(tmp_path, steps=[{"table": {"file": str(tmp_path / "table.csv")}}]))


def test_a_python_file_that_sets_no_value_is_a_fault_at_its_line_with_a_result(tmp_path: Path) -> None:
    code = "def experiment(bench):\n    yield\n    bench.set('load.web.youngs_modulus_Pa', '9e9')\n"
    (tmp_path / "own.py").write_text(code)
    steps = [{"python": {"file": str(tmp_path / "own.py")}}]
    ran = hilbench("run", config(tmp_path, steps=steps), "--in-process", "--out", tmp_path / "runs")
    assert ran.returncode == 3
    said = f"{tmp_path / 'own.py'}:3: load.web.youngs_modulus_Pa is '9e9', expected a number from 1000 to 1e+13 Pa"
    assert said.replace(" ", "") in ran.stdout.replace("\n", "").replace(" ", "")


@pytest.mark.parametrize("text", ["steps.0.ramp.to=fast", "steps.0.ramp.to=.nan", "load.web.youngs_modulus_Pa=0"])
def test_a_value_on_the_command_line_is_refused_with_its_option(tmp_path: Path, text: str) -> None:
    checked = hilbench("check", config(tmp_path), "--set", text)
    assert checked.returncode == 2
    assert checked.stderr.startswith(f"hilbench: --set {text}: ")


def test_the_shipped_configs_ask_for_nothing_that_can_not_be() -> None:
    for path in sorted((Path(__file__).resolve().parents[2] / "bench_configs").glob("*.yaml")):
        load(path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        "hardware.effects.friction_asymmetry.axis2.viscous_difference_N_s_per_m",  # drives itself on, beyond all bounds
        *fast_path_places(MachineKind.WEB_LINE, smallest_shapes()["web_line"]),
        "hardware.effects.torque_scale.axis1.relative_change",
        "load.effects.span_length_error.relative_change",
        "load.effects.strain_offset.strain",
    ],
)
def test_a_running_bench_at_the_ends_of_a_range_ends_well_or_by_a_fault(tmp_path: Path, path: str) -> None:
    for value in (permitted(path).lower, permitted(path).upper):
        running, said = bench(tmp_path), ""
        try:
            with running:
                running.ramp("line_speed_m_s", 0.5, 0.2)
                running.set(path, value)
                running.run(0.3)
        except BenchFaultError as fault:
            said = str(fault)
        assert bool(said) == (running.fault_time_s is not None)
        assert not said or running.time_s > 0.19  # told when it happened, not at the start
