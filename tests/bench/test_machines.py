"""A machine is a list of tasks: what the bench's cycle does not know, another list can be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from tests.bench.test_runs import config

from hilbench.bench import bench as library
from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.machines.machine import MachineTasks
from hilbench.bench.machines.web_line import BoundaryTask
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.bench.tasks.task import CyclicTask, Outputs
from hilbench.bench.tasks.watches import Watch
from hilbench.errors import BenchFaultError
from hilbench.exchange.exchange import Inputs
from hilbench.machine_kinds import machine_part
from hilbench.runs.config import load_with_overrides
from hilbench.topology.config import BenchConfig
from hilbench.topology.sample import CycleSample


class Spindle(CyclicTask):
    """Turns axis 2 at the reference; counts in which of its moments it was called."""

    def __init__(self, reference: Reference) -> None:
        self.calls: list[str] = []
        self._reference = reference

    def before(self, sample: CycleSample, outputs: Outputs) -> None:
        self.calls.append("before")
        outputs["axis2"] = self._reference.present

    def after(self, sample: CycleSample, inputs: Inputs) -> None:
        self.calls.append("after")

    def rest(self, sample: CycleSample, outputs: Outputs) -> None:
        self.calls.append("rest")


@pytest.fixture
def spindle(monkeypatch: pytest.MonkeyPatch) -> list[Spindle]:
    """The demonstrator's nodes as another machine: no web, no tension loop, one axis that turns."""
    made: list[Spindle] = []

    of_config = machine_part("web_line", "tasks")

    def tasks(config: BenchConfig, state: BenchState) -> MachineTasks:
        reference = Reference("line_speed_m_s", config.safety.quick_stop_m_s2 * config.cycle_time_s)
        made.append(Spindle(reference))

        def too_fast(sample: CycleSample) -> list[tuple[str, str]]:
            if sample.v2_m_s > 0.9:
                raise BenchFaultError("the spindle is too fast")
            return [("fast", "the spindle is fast")] if sample.v2_m_s > 0.4 else []

        return replace(
            of_config(config, state),
            reference=reference,
            quantities=(reference,),
            control=(BoundaryTask(0.0, 0.0, {}), made[-1]),
            watches=(Watch("spindle", too_fast, state.reports),),
        )

    monkeypatch.setattr(library, "machine_part", lambda kind, name: tasks)
    return made


def bench(folder: Path) -> Bench:
    return Bench(load_with_overrides(config(folder)).config, participants=Participants.IN_PROCESS)


def test_another_list_of_tasks_is_another_machine_on_the_same_bench(tmp_path: Path, spindle: list[Spindle]) -> None:
    with bench(tmp_path) as running:
        (task,) = spindle
        assert set(task.calls) == {"rest"}  # not before the drives are enabled
        task.calls.clear()
        running.ramp("line_speed_m_s", 0.5, duration_s=0.3)
        running.run(0.3)
        assert running.last.v2_m_s == pytest.approx(0.5, abs=0.02)
        assert running.last.v1_m_s == pytest.approx(0.0, abs=0.02)  # nobody commands axis 1
        assert running.last.tau_load_cmd_Nm == 0.0
        assert task.calls == ["before", "after"] * 300
        task.calls.clear()
    # Brought to rest at the rate of a quick stop, 3 m/s² over 2 ms, before the drives are let go.
    assert task.calls.count("before") == 84
    assert task.calls[-1] == "rest"
    said = [notice for notice in running.notices if notice.source == "spindle"]
    assert [(notice.text, notice.count > 1) for notice in said] == [("the spindle is fast", True)]


def test_a_fault_that_a_task_finds_ends_the_run_in_the_safe_state(tmp_path: Path, spindle: list[Spindle]) -> None:
    running = bench(tmp_path)
    with pytest.raises(BenchFaultError, match="the spindle is too fast"), running:
        running.ramp("line_speed_m_s", 2.0, duration_s=0.5)
    assert 0.2 < (running.fault_time_s or 0.0) < 0.4
    assert running.safe_state_problems == []
    assert not running.enabled
    assert spindle[0].calls[-1] == "rest"


@pytest.mark.parametrize(("goal", "steps"), [(1.0, 4), (-0.7, 3), (0.0, 0)])
def test_a_reference_goes_to_its_goal_by_steps_and_stays_there(goal: float, steps: int) -> None:
    reference = Reference("speed", step=0.3)
    taken = []
    reached = goal == reference.present
    while not reached:
        value, reached = reference.step_to(goal)
        taken.append(value - reference.present)
        reference.set("speed", value)
    assert len(taken) == steps
    assert max(map(abs, taken), default=0.0) <= 0.3 + 1e-12
    assert reference.present == pytest.approx(goal)
    assert reference.goal is None


def test_what_an_experiment_sets_is_where_a_reference_stays() -> None:
    reference = Reference("speed", step=0.3)
    reference.move_to(2.0)
    assert reference.goal == 2.0
    reference.set("speed", 0.7)
    assert (reference.goal, reference.present) == (None, 0.7)
    assert [reference.slow_down() for _ in range(4)] == [True, True, True, False]
    assert reference.present == 0.0
