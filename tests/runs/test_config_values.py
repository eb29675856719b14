"""Every number of a config: what can't be is refused with its place, what is taken can be brought up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.bench.whole_runs import config
from tests.cli.in_process import hilbench
from tests.tiers import slow

from hilbench import strict_yaml
from hilbench.apps.scripts.bench import Bench
from hilbench.bench.check import check_bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.block import LARGEST, LEAST
from hilbench.errors import BenchFaultError, UnusableInputError
from hilbench.estimation.web_line.config import METHODS
from hilbench.runs.config import ExperimentConfig, load

SHIPPED = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"


def leaves(data: Any, location: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Where each value of a config stands, given or by default."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    if not inner or (isinstance(data, list) and not (data and isinstance(data[0], dict))):
        yield location
        return
    for key, value in inner:
        yield from leaves(value, (*location, key))


@cache
def shipped() -> tuple[strict_yaml.Document, list[tuple[str | int, ...]]]:
    config, document = load(SHIPPED)
    keys = list(leaves(config.model_dump(mode="json")))
    for method, kind in METHODS.items():
        if method != config.twin.synchronizer.method:
            keys += [("twin", "estimate", method, name) for name in kind.model_fields if name != "method"]
    return document, keys


def changed(location: tuple[str | int, ...], value: object) -> tuple[ExperimentConfig | None, str]:
    """The shipped config with another value, or what is said against it."""
    document = shipped()[0]
    option = f"--set {'.'.join(map(str, location))}"
    if location[:2] == ("twin", "estimate") and location[2] in METHODS:
        document = document.with_value(location[:2], [{"method": location[2], location[3]: value}], option)
    else:
        document = document.with_value(location, value, option)
    try:
        found = strict_yaml.validate(document, ExperimentConfig)
        check_bench(found, document)
    except UnusableInputError as error:
        return None, str(error)
    return found, ""


HOSTILE = [0, -1, math.nan, math.inf, -math.inf, 1e300, -1e300, 1e-300, 10**30, 1e6, 1e-6, "3", "x", True, None, [], {}]


@settings(max_examples=60, deadline=None, database=None)
@given(st.sampled_from(shipped()[1]), st.sampled_from([*HOSTILE, [1.0, -1.0, 3.0]]) | st.floats())
def test_a_hostile_value_is_refused_in_one_printable_line_or_taken_as_the_number_it_is(
    location: tuple[str | int, ...], value: object
) -> None:
    found, said = changed(location, value)
    if found is None:
        assert said.isprintable()
        return
    if isinstance(value, float):
        assert value == 0.0 or LEAST <= abs(value) <= LARGEST


@pytest.mark.parametrize("value", [math.nan, math.inf, "3", True, 1e300])
@pytest.mark.parametrize(
    "key",
    [
        "cycle_time_s",
        "machine.web.youngs_modulus_Pa",
        "machine.rollers.radius_m",
        "machine.boundary.upstream_tension_N",
        "safety.quick_stop_m_s2",
        "safety.limits.tension_N.trip",
        "load_motors.load.motor.torque_limit_Nm",
        "hardware.sensors.torque_noise_Nm",
        "controllers.tension_control.bandwidth_rad_per_s",
        "twin.synchronized_pct",
        "master.boot_timeout_s",
    ],
)
def test_a_number_that_is_none_or_beyond_everything_is_refused_by_its_key(key: str, value: object) -> None:
    found, said = changed(tuple(key.split(".")), value)
    assert found is None
    assert said.startswith(f"--set {key}: '{key}' is ")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("machine.drives.sample_time_s=0.0015", "a multiple of the drives' sample time 0.0015 s"),
        ("cycle_time_s=0.0025", "a multiple of the drives' sample time 0.001 s"),
        ("machine.boundary.upstream_tension_N=1e6", "strains the web that enters by"),
        ("machine.web.youngs_modulus_Pa=1e3", "strains the web that enters by"),
        ("load.web.youngs_modulus_Pa=-9e9", "expected: 1000 or more"),
        ("load.web.span_length_m=.inf", "load.web.span_length_m"),
        ("twin.estimate=[{method: rls, memory_s: yes}]", "memory_s"),
        ("controllers.tension_control.bandwidth_rad_per_s=1e6", "the tension loop is unstable"),
    ],
)
def test_values_that_do_not_go_together_are_refused_by_check_and_run(tmp_path: Path, change: str, said: str) -> None:
    path = config(tmp_path)
    checked = hilbench("check", path, "--set", change)
    ran = hilbench("run", path, "--in-process", "--out", tmp_path / "runs", "--set", change)
    assert (checked.returncode, ran.returncode) == (2, 2)
    assert checked.stderr == ran.stderr
    assert said in checked.stderr
    assert checked.stderr.count("\n") == 1
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "change",
    [
        "machine.boundary.upstream_tension_N=0",
        "machine.boundary.upstream_strain=-0.4",
        "machine.drives.velocity_ki_Nm_per_rad=0",
        "machine.web.thickness_m=1e-6",
        "hardware.sensors.position_noise_rad=1e6",
        *slow(
            "hardware.sensors.torque_noise_Nm=1e6",
            "load.web.span_length_m=1e4",
            "twin.unmodelled_torque_Nm=0",
            "twin.youngs_modulus_Pa=1e13",
        ),
    ],
)
def test_a_bench_with_a_value_at_the_edge_runs_or_ends_by_a_fault_that_is_known(tmp_path: Path, change: str) -> None:
    running = Bench(config(tmp_path), changes=[change], participants=Participants.IN_PROCESS)
    try:
        with running:
            running.ramp("line_speed_m_s", 0.5, 0.1)
            running.run(0.2)
    except BenchFaultError:
        assert running.fault_time_s is not None
    assert not [problem for problem in running.safe_state_problems if "unexpected" in problem]
