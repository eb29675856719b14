"""The shipped line of four driven rollers: it does what its config says, on any bus the same to the bit."""

from __future__ import annotations

import re
from pathlib import Path
from struct import pack

import numpy as np
import pytest
from tests.bench.whole_runs import Shipped

from hilbench.bench.lifecycle.participants import Participants
from hilbench.estimation.problems import TORQUE_SHIFT, Problem
from hilbench.exchange.emergencies import Emergency
from hilbench.exchange.nodes import Nodes
from hilbench.results.recording import Recording, read_recording
from hilbench.results.run import run_experiment
from hilbench.runs.config import load_with_overrides

CONFIG = Path(__file__).resolve().parents[2] / "bench_configs" / "line_three_spans.yaml"
#: The shipped experiment, told faster.
SHORTER = (
    "steps.0.ramp.duration_s=1.0",
    "steps.0.ramp.to=1.0",
    "steps.1.hold.until_s=1.5",
    "steps.3.hold.duration_s=0.5",
    "steps.5.hold.duration_s=1.0",
    "steps.6.ramp.duration_s=0.5",
    "criteria=[]",
)


@pytest.fixture
def recording(shipped: Shipped) -> Recording:
    return read_recording(shipped("line_three_spans").folder.recording)


@pytest.mark.slow
def test_it_passes_all_its_criteria(shipped: Shipped) -> None:
    result = shipped("line_three_spans").result
    assert result.faults == []
    assert len(result.criteria) == 13
    assert {row.name: row.verdict for row in result.criteria if row.verdict != "passed"} == {}


def test_its_recording_has_every_axis_load_motor_and_span(recording: Recording) -> None:
    axes = {f"{name}{k}_{unit}" for k in range(1, 5) for name, unit in (("x", "m"), ("v", "m_s"), ("tau", "Nm"))}
    motors = {f"tau_load_{name}_cmd_Nm" for name in ("print_1", "print_2", "outfeed")}
    spans = {f"F{k}_{what}_N" for k in (1, 2, 3) for what in ("true", "sim", "ref")}
    assert axes | motors | spans | {"strain_prev", "F_next_N"} < set(recording.channels)


def test_each_load_motor_pulls_by_the_tensions_around_its_roller(recording: Recording) -> None:
    steady = (np.asarray(recording["t_s"]) > 6.0) & (np.asarray(recording["t_s"]) < 6.9)
    F_N = [float(np.mean(np.asarray(recording[name])[steady])) for name in ("F1_true_N", "F2_true_N", "F3_true_N")]
    for name, before_N, behind_N in zip(("print_1", "print_2", "outfeed"), F_N, [*F_N[1:], 70.0], strict=True):
        torque_Nm = float(np.mean(np.asarray(recording[f"tau_load_{name}_cmd_Nm"])[steady]))
        assert torque_Nm == pytest.approx((behind_N - before_N) * 0.2 / 5.0, abs=0.02)


def test_the_twin_tells_what_is_at_its_third_span(recording: Recording) -> None:
    """Its objects have two digits: 6403h sub 0Bh and following."""
    nodes = Nodes(load_with_overrides(CONFIG).config)
    third = nodes.io.sent[4]
    assert [(variable.index, variable.subindex) for variable in third.variables] == [(0x6403, 11), (0x6403, 12)]
    assert float(np.asarray(recording["E3_sim_Pa"])[-1000:].mean()) == pytest.approx(10.5e9, rel=0.01)


@pytest.mark.slow
def test_processes_record_the_bits_of_one_process(tmp_path: Path) -> None:
    given = load_with_overrides(CONFIG, bus=f"embedded:{tmp_path.name}", changes=SHORTER)
    apart, together = (
        read_recording(run_experiment(given, tmp_path / how.name, participants=how).folder.recording)
        for how in (Participants.STARTED, Participants.IN_PROCESS)
    )
    assert list(apart.channels) == list(together.channels)
    assert len(apart) > 1000
    assert [name for name in apart.channels if not np.array_equal(apart[name], together[name])] == []


def test_a_web_break_is_told_with_its_span(tmp_path: Path) -> None:
    steps = [
        "steps=[{ramp: {path: line_speed_m_s, to: 1.0, duration_s: 1.0}}, {hold: {duration_s: 1.0}}, "
        "{set: {path: load.web.broken, to: 1}}, {hold: {duration_s: 3.0}}]",
        "criteria=[]",
    ]
    given = load_with_overrides(CONFIG, bus=f"embedded:{tmp_path.name}", changes=steps)
    outcome = run_experiment(given, tmp_path, participants=Participants.IN_PROCESS)
    [fault] = outcome.result.faults
    told = re.search(r"reports a web break in span ([123])", fault.text)
    assert told is not None, fault.text
    assert any(f"web break in span {told[1]}" in warning for warning in outcome.result.all_warnings())


@pytest.mark.parametrize("span", [0, 2])
def test_an_alarm_of_the_twin_names_its_span_where_there_are_several(span: int) -> None:
    def message(code: int, info: bytes = bytes(4)) -> str:
        found = Emergency.of(32, "virtual io", code.to_bytes(2, "little") + b"\x21" + info + bytes((span,)))
        return str(found)

    where = " in span 2" if span else ""
    assert message(Problem.SLACK) == f"EMCY FF13h: slack{where}"
    assert message(Problem.SLIP) == f"EMCY FF16h: slip{where}"
    axis = 3 if span else 2
    assert f"of axis {axis}, +0.5 N·m" in message(TORQUE_SHIFT, pack("<f", 0.5))
    assert message(0x8110).endswith("communication")
