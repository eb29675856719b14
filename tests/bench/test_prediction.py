"""A bench that looks ahead: what it announces, what it does about it, and what it leaves alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Event
from time import sleep
from types import SimpleNamespace

import numpy as np
import pytest
from tests.bench.whole_runs import Shipped

from hilbench.bench.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.bench.prediction.task import Prediction
from hilbench.bench.prediction.window import Hindsight, Window
from hilbench.bench.state import BenchState
from hilbench.bench.tasks.reference import Reference
from hilbench.errors import EXIT_BENCH_FAULT, EXIT_PASSED, UnusableInputError
from hilbench.prediction.config import PredictionConfig
from hilbench.prediction.outlook import Outlook, WatchedQuantity
from hilbench.prediction.plan import Asked, Move
from hilbench.results.journal import read_journal
from hilbench.results.recording import read_recording
from hilbench.results.result import Result
from hilbench.results.run import RunOutcome, run_experiment
from hilbench.runs.config import load_with_overrides
from hilbench.runs.set_point_schedule import LookAhead
from hilbench.topology.sample import CycleSample, sample_type

CONFIGS = Path(__file__).resolve().parents[2] / "bench_configs"
#: The shipped experiment, told faster: 1.5 s to 3 m/s, one step of E at 4 s.
SHORTER = (
    "steps.0.ramp.duration_s=1.5",
    "steps.1.hold.until_s=4.0",
    "steps.3.hold.duration_s=0.4",
    "steps.5.hold.duration_s=0.4",
    "steps.7.hold.duration_s=0.4",
    "steps.8.ramp.duration_s=1.0",
    "twin.prediction.horizon_s=2.0",
    "twin.prediction.futures=32",
)
TRIPS = ("safety.limits.tension_N={trip: 90.0}",)


def run(
    folder: Path, *changes: str, config: str = "predicted_limit.yaml", shorter: tuple[str, ...] = SHORTER
) -> RunOutcome:
    loaded = load_with_overrides(CONFIGS / config, changes=(*shorter, *changes))
    return run_experiment(loaded, folder, participants=Participants.IN_PROCESS)


@pytest.mark.slow
def test_the_shipped_experiment_knows_its_crossings_seconds_before(shipped: Shipped) -> None:
    outcome = shipped("predicted_limit")
    assert outcome.exit_code == EXIT_PASSED, outcome.result.criteria
    predicted = Result.read(outcome.folder.result).predicted
    assert predicted is not None
    assert [(each.signal, each.level, round(each.crossed_s or 0.0, 1)) for each in predicted] == [
        ("F_true_N", "warning", 6.0),
        ("F_true_N", "warning", 14.0),
    ]
    for each in predicted:
        assert each.crossed_s == pytest.approx(each.expected_s, abs=0.05)
        assert each.probability > 0.9
    journal = [change for change in read_journal(outcome.folder.journal) if change.what == "predicted"]
    assert [(change.path, change.value) for change in journal] == [("F_true_N", 90.0)] * 2
    assert any(notice.source == "prediction" for notice in outcome.result.warnings or ())


@pytest.mark.slow
def test_the_same_seed_predicts_the_same_and_leaves_the_run_as_it_is(tmp_path: Path) -> None:
    first, second = run(tmp_path / "a"), run(tmp_path / "b")
    without = run(tmp_path / "c", "twin.prediction=null")
    assert first.result.predicted == second.result.predicted
    assert first.result.predicted
    assert without.result.predicted is None
    assert "limits_predicted" not in without.result.metrics
    recordings = [read_recording(each.folder.recording) for each in (first, second, without)]
    for name in recordings[0].channels:
        assert all((each[name] == recordings[0][name]).all() for each in recordings[1:]), name


def test_a_bench_that_is_to_stop_does_so_before_the_limit_is_crossed(tmp_path: Path) -> None:
    outcome = run(tmp_path, *TRIPS, "safety.on_predicted_limit=stop")
    assert outcome.exit_code == EXIT_BENCH_FAULT
    (fault,) = outcome.result.faults
    assert "predicted: tension of the web beyond its trip level 90 N" in fault.text
    assert fault.time_s is not None
    assert fault.time_s < 4.0
    (made,) = outcome.result.predicted or ()
    assert (made.action, made.crossed_s) == ("stopped", None)
    assert outcome.result.metrics["limits_predicted_in_vain"] == 0.0


@pytest.mark.slow
def test_a_bench_that_is_to_slow_down_keeps_below_the_limit_of_the_speed(tmp_path: Path) -> None:
    limit = ("safety.limits.speed_m_s={trip: 2.5}", "safety.limits.tension_N={}")
    tripped = run(tmp_path / "a", *limit)
    assert tripped.exit_code == EXIT_BENCH_FAULT
    outcome = run(tmp_path / "b", *limit, "safety.on_predicted_limit=slow_down", "criteria=[]")
    assert outcome.exit_code == EXIT_PASSED, outcome.result.faults
    speed = read_recording(outcome.folder.recording)["v2_m_s"]
    assert 1.0 < speed.max() < 2.5
    assert {each.action for each in outcome.result.predicted or ()} == {"slowed down"}
    assert any("is held below" in each.text for each in outcome.result.warnings or ())


STEP_CHECKED = "steps.2.step={path: load.web.youngs_modulus_Pa, to: 10.5e+9, check: predicted}"


@pytest.mark.slow
def test_a_step_that_would_trip_a_limit_is_refused_before_it_is_done(tmp_path: Path) -> None:
    outcome = run(tmp_path, *TRIPS, STEP_CHECKED)
    assert outcome.exit_code == EXIT_BENCH_FAULT
    (fault,) = outcome.result.faults
    assert (
        "load.web.youngs_modulus_Pa to 1.05e+10 is refused: tension of the web beyond its trip level 90 N" in fault.text
    )
    assert "expected at most 10 %" in fault.text
    tension = read_recording(outcome.folder.recording)["F_true_N"]
    assert tension.max() < 85.0


@pytest.mark.slow
def test_a_step_that_keeps_within_the_limits_is_done(tmp_path: Path) -> None:
    outcome = run(tmp_path, "safety.limits.tension_N={trip: 120.0}", STEP_CHECKED, "criteria=[]")
    assert outcome.exit_code == EXIT_PASSED, outcome.result.faults
    assert read_recording(outcome.folder.recording)["E_true_Pa"].max() == pytest.approx(13.0e9)


@pytest.mark.slow
def test_a_ramp_that_the_drives_cannot_follow_within_their_limit_is_refused(tmp_path: Path) -> None:
    checked = "steps.8.ramp={path: line_speed_m_s, to: 0.0, duration_s: 0.5, check: predicted}"
    outcome = run(tmp_path, "safety.limits.torque_Nm={trip: 6.0}", "safety.limits.tension_N={}", checked)
    assert outcome.exit_code == EXIT_BENCH_FAULT
    (fault,) = outcome.result.faults
    assert "line_speed_m_s to 0 is refused: torque of axis" in fault.text


def test_a_check_in_a_bench_that_does_not_look_ahead_is_refused_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="'predicted' in a bench that does not look ahead"):
        run(tmp_path, STEP_CHECKED, "twin.prediction=null")


def test_a_step_before_the_twin_knows_the_machine_cannot_be_checked(tmp_path: Path) -> None:
    checked = "steps.0.ramp={path: line_speed_m_s, to: 1.0, duration_s: 1.0, check: predicted}"
    outcome = run(tmp_path, checked)
    assert outcome.exit_code == EXIT_BENCH_FAULT
    assert "can't be checked: the twin is not synchronized" in outcome.result.faults[0].text


@pytest.mark.slow
def test_on_a_line_of_two_spans_each_tension_is_foreseen_by_its_name(tmp_path: Path) -> None:
    steps = """steps=[
      {ramp: {path: line_speed_m_s, to: 2.0, duration_s: 1.0}}, {hold: {until_s: 2.5}},
      {step: {path: tension_control.span2.set_point_N, to: 110.0}}, {hold: {duration_s: 1.0}}]"""
    changes = (
        "twin.prediction={horizon_s: 2.0, futures: 16}",
        "safety.limits.tension_N={warning: 100.0}",
        "criteria=[]",
        "controllers.infeed_tension.feed_forward=none",  # futures know the loops without it
        "controllers.press_tension.feed_forward=none",
    )
    outcome = run(tmp_path, steps, *changes, config="line_two_spans.yaml", shorter=())
    assert outcome.exit_code == EXIT_PASSED, outcome.result.faults
    (made,) = outcome.result.predicted or ()
    assert (made.signal, made.quantity) == ("F2_true_N", "tension of span 2")
    assert made.t_s < 2.5
    assert made.crossed_s == pytest.approx(made.expected_s, abs=0.1)
    assert outcome.result.metrics["limits_not_predicted"] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("span", [1, 2])
def test_a_change_of_the_modulus_is_foreseen_as_the_twin_will_find_it(span: int) -> None:
    """The loops go by what the twin tells, which follows a step by and by: so does the tension."""
    changes = (
        "twin.prediction={horizon_s: 2.0, futures: 16}",
        "safety.limits.tension_N={warning: 100.0}",
        f"""steps=[{{ramp: {{path: line_speed_m_s, to: 1.5, duration_s: 1.0}}}}, {{hold: {{until_s: 3.0}}}},
          {{step: {{path: load.web.span{span}.youngs_modulus_Pa, to: 9.57e9}}}}, {{hold: {{duration_s: 0.5}}}}]""",
        "criteria=[]",
    )
    config = load_with_overrides(CONFIGS / "line_two_spans.yaml", changes=changes).config
    tensions: list[float] = []
    seen = SimpleNamespace(sample=lambda sample: tensions.append(getattr(sample, f"F{span}_true_N")))
    look_ahead = LookAhead(config)
    with Bench(config, observers=[seen], participants=Participants.IN_PROCESS) as bench:
        bench.foresee(look_ahead.plan(0, 0.0))
        config.steps[0].run(bench, [])
        bench.foresee(look_ahead.plan(1, bench.time_s))
        bench.run(2.5 - bench.time_s)
        assert bench.prediction is not None
        outlook = bench.prediction.outlook
        assert outlook is not None
        bench.run(3.0 - bench.time_s)
        for step in config.steps[2:]:
            step.run(bench, [])
    came_s, place = (1 + np.arange(len(tensions))) * config.cycle_time_s, outlook.place(f"F{span}_true_N")
    after = (outlook.times_s > 3.05) & (outlook.times_s < 3.45)
    came_N = np.interp(outlook.times_s[after], came_s, tensions)
    assert np.median(outlook.rows[after][:, :, place], axis=1) == pytest.approx(came_N, abs=1.6)
    assert np.median(outlook.largest[:, place]) == pytest.approx(max(tensions), abs=0.4)


class StillRunning:
    """A look that takes its time: what it says is there when it is let go on."""

    watched = (
        WatchedQuantity("speed of axis 1", "v1_m_s", "m/s", warning=1.0),
        WatchedQuantity("speed of axis 2", "v2_m_s", "m/s"),
    )
    signals = ("v1_m_s", "v2_m_s")

    def __init__(self) -> None:
        self.continues = Event()
        self.begun = 0

    def warm_up(self) -> None:
        """Nothing to compile."""

    def ready(self, sample: CycleSample) -> bool:
        """Always."""
        return True

    def moves_of(self, move: Move) -> tuple[Move, ...]:
        """One quantity."""
        return (move,)

    def prepare(
        self, now_s: float, window: Window, hindsight: Hindsight, asked: Asked, *key: int
    ) -> tuple[Callable[[], None], Callable[[], Outlook]]:
        """Waits in its thread, then sees a crossing."""
        self.begun += 1
        times_s, rows = now_s + np.arange(1.0, 3.0), np.full((2, 16, 2), 2.0)
        outlook = Outlook(
            now_s,
            self.watched,
            times_s,
            rows,
            rows[0],
            np.array([[1.0, 0.0], [0.0, 0.0]]),
            np.full((16, 2, 2), now_s),
            np.zeros(2),
        )
        return (lambda: self.continues.wait(30.0) and None), lambda: outlook


def test_in_real_time_no_cycle_waits_for_a_look_and_one_that_is_late_leaves_the_next_out() -> None:
    config = load_with_overrides(CONFIGS / "predicted_limit.yaml").config
    said: list[str] = []
    sample = sample_type(config.signals)()
    state = BenchState(0.01, sample, said.append, lambda change: None)
    state.running = lambda: SimpleNamespace(timing=SimpleNamespace(cycles=0))  # type: ignore[method-assign,assignment,return-value]
    look, wanted = StillRunning(), PredictionConfig(every_s=0.1)
    prediction = Prediction(
        look,
        wanted,
        state,
        Asked,
        seed=1,
        lockstep=False,
        on_predicted_limit="warn",
        reference=Reference("line_speed_m_s", 0.01),
    )
    try:
        for cycle in range(1, 61):
            sample.cycle, sample.t_s = cycle, 0.01 * cycle
            prediction.after(sample, SimpleNamespace())  # type: ignore[arg-type]
        assert (look.begun, prediction.looks, said) == (1, 0, [])
        assert prediction.left_out >= 3
        look.continues.set()
        for cycle in range(61, 1000):
            sample.cycle, sample.t_s = cycle, 0.01 * cycle
            prediction.after(sample, SimpleNamespace())  # type: ignore[arg-type]
            if prediction.looks:
                break
            sleep(0.01)
        assert "speed of axis 1 beyond its warning level 1 m/s" in said[0]
    finally:
        look.continues.set()
        prediction.close()
