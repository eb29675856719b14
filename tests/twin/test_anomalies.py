"""Break, slip and change of E of the web, told apart by the twin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.bench.whole_runs import config, result_of, run_folders, run_here
from tests.estimation.runs import CYCLE_S, OLD_PA, STEP_S, Array, measured, stepped, times
from tests.plant.models import model
from tests.tiers import slow

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.estimation.problems import Problem
from hilbench.estimation.web_line.config import EstimationConfig
from hilbench.estimation.web_line.span_estimator import SpanEstimator
from hilbench.plant.motor_port import MotorMode, MotorPort
from hilbench.plant.web_line.line import Line
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.results.trace import TraceReader
from hilbench.runs.config import load_with_overrides
from hilbench.twin.reports import Alarms

AT_SPEED = [
    {"ramp": {"path": "line_speed_m_s", "to": 3.0, "duration_s": 1.0}},
    {"hold": {"until_s": 1.5}},
]
WITHIN_CYCLES = 100
CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "web_section_step.yaml"


def emergencies(folder: Path) -> list[int]:
    """Error codes of the twin's EMCY messages."""
    frames = TraceReader(folder / "trace.log")
    return [int.from_bytes(data[:2], "little") for can_id, data, _ in frames if can_id == 0x0A0]


def test_a_web_break_is_told_within_200_ms_and_stops_the_line(tmp_path: Path) -> None:
    steps = [*AT_SPEED, {"step": {"path": "load.web.broken", "to": 1}}, {"hold": {"duration_s": 2.0}}]
    path = config(tmp_path, steps=steps)
    code, out, _ = run_here(path)
    folder = run_folders(path)[0]
    assert code == 3
    assert "web break" in out
    result = result_of(folder)
    assert result.faults[0].time_s is not None
    # The fault comes with the EMCY, which the bench has at the end of the same cycle.
    assert 1.5 < result.faults[0].time_s <= 1.5 + WITHIN_CYCLES * 0.002
    assert emergencies(folder)[0] == Problem.WEB_BREAK


def slipping(
    modulus_Pa: Array, slip: Array, plant: ModelParameters | None = None, known: bool = False, **options: float
) -> set[float]:
    """When (s) the twin said slip, of a web of modulus E (n,) whose roller 2 is faster than it by a share (n,).

    `known`: the twin takes all but E for known.
    """
    plant = plant or model()
    data = measured(modulus_Pa, plant=plant, **options)
    data.x_m[:, 1] += np.cumsum(slip * 3.0) * CYCLE_S
    ports = (MotorPort(mode=MotorMode.VELOCITY), MotorPort(mode=MotorMode.VELOCITY))
    estimation = EstimationConfig(unmodelled_torque_Nm=0.0 if known else None)
    tracking = SpanEstimator(plant, estimation, Line(plant, ports), CYCLE_S)
    told = set()
    for row, t_s in enumerate(data.t_s):
        x1, x2 = data.x_m[row]
        tracking.compare(x1, x2, data.tau2_Nm[row], ports[1].torque_Nm, data.strain_prev[row], data.F_next_N[row])
        assert tracking.problem in (None, Problem.SLIP)
        if tracking.problem is Problem.SLIP:
            told.add(float(t_s))
    return told


def test_slip_is_told_and_changes_of_e_are_not_taken_for_it() -> None:
    t_s = times(6.0)
    none = np.zeros(len(t_s))
    for modulus_Pa in (stepped(), stepped(to_Pa=6.5e9), OLD_PA * (1.0 + 0.03 * t_s)):
        assert not slipping(modulus_Pa, none)
    slips = np.where(t_s >= STEP_S, 0.3 * model().upstream_strain, 0.0)
    told = slipping(OLD_PA + 0.0 * t_s, slips)
    # It takes a span's length of web to tell a slip from a change of E: 0.33 s.
    assert STEP_S + 0.33 < min(told) < STEP_S + 0.6


def test_what_is_told_of_a_web_under_little_tension_is_told_as_of_any_other() -> None:
    light = model(boundary={"upstream_tension_N": 8.0, "downstream_tension_N": 7.0})
    t_s = times(6.0)
    slips = np.where(t_s >= STEP_S, 0.3 * light.upstream_strain, 0.0)
    told = slipping(OLD_PA + 0.0 * t_s, slips, light, known=True, torque_noise_Nm=0.005)
    assert STEP_S + 0.33 < min(told) < STEP_S + 0.6


@pytest.mark.parametrize("frequency_Hz", [0.5, *slow(1.0, 2.0)])
def test_a_tension_upstream_that_swings_is_no_slip(frequency_Hz: float) -> None:
    config = load_with_overrides(CONFIG).config
    with Bench(config, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 3.0, 2.0)
        bench.run(2.0)
        bench.set("load.effects.upstream_disturbance.frequency_Hz", frequency_Hz)
        bench.set("load.effects.upstream_disturbance.amplitude_N", 10.0)
        bench.run(6.0)
        assert not [notice.text for notice in bench.notices if "FF16" in notice.text]


def test_a_condition_that_comes_and_goes_is_one_alarm_and_another_one_is_told_at_once() -> None:
    alarms = Alarms(CYCLE_S)
    begun, ended = [], []
    for k in range(2000):
        problem = Problem.SATURATED if k < 1000 and k % 20 < 3 else Problem.WEB_BREAK if k == 1001 else None
        told, over = alarms.update(problem)
        begun += [(k, one) for one in told]
        ended += [(k, one) for one in over]
    assert begun == [(0, Problem.SATURATED), (1001, Problem.WEB_BREAK)]
    assert ended == [(982 + 250, Problem.SATURATED), (1001 + 250, Problem.WEB_BREAK)]
