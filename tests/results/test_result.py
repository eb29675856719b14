"""result.json is what the design promises, and is read back as it was."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hilbench.apps.commands.run import show_outcome
from hilbench.errors import UnusableInputError
from hilbench.results.result import Environment, Fault, Histogram, Result, Timing, jitter
from hilbench.results.run import RunOutcome
from hilbench.results.run_folder import RunFolder
from hilbench.runs.criteria import CriterionResult

PASSED = CriterionResult(name="E found", value=19.5, limit="≤ 25", unit="s", passed=True)
FAILED = CriterionResult(name="noise", value=None, limit="≤ 1", unit="%", passed=False, reason="not there")


def timing(lateness_us: list[float] | None = None) -> Timing:
    percentiles, histogram = jitter(lateness_us or [])
    return Timing(
        pace="lockstep",
        cycle_us=2000,
        cycles=30000,
        missed=0,
        jitter_us=percentiles,
        realtime_factor=4.2,
        bus_load_pct=61.5,
        jitter_histogram=histogram,
    )


def test_the_file_has_the_designs_keys(tmp_path: Path) -> None:
    Result.of([PASSED], {"E_time_to_1pct_s": 19.5, "E_noise_pct": None}, timing(), []).write(tmp_path / "result.json")
    assert json.loads((tmp_path / "result.json").read_text()) == {
        "passed": True,
        "criteria": [{"name": "E found", "value": 19.5, "limit": "≤ 25", "unit": "s", "passed": True}],
        "metrics": {"E_time_to_1pct_s": 19.5, "E_noise_pct": None},
        "timing": {
            "pace": "lockstep",
            "cycle_us": 2000.0,
            "cycles": 30000,
            "missed": 0,
            "jitter_us": None,
            "realtime_factor": 4.2,
            "bus_load_pct": 61.5,
        },
        "faults": [],
    }
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_round_trip_with_everything(tmp_path: Path) -> None:
    fault = Fault(time_s=12.5, source="axis 2", text="EMCY 8611h following error")
    result = Result.of([PASSED, FAILED], {"a": 1.0}, timing([1, 2, 3]), [fault], Environment.here(seed=7))
    result.write(tmp_path / "result.json")
    assert Result.read(tmp_path / "result.json") == result


@pytest.mark.parametrize(
    ("criteria", "faults", "passed"),
    [
        ([], [], None),
        ([PASSED], [], True),
        ([PASSED, FAILED], [], False),
        ([PASSED], [Fault(time_s=None, source="node 2", text="no boot-up")], False),
    ],
)
def test_passed_follows(criteria: list[CriterionResult], faults: list[Fault], passed: bool | None) -> None:
    assert Result.of(criteria, {}, timing(), faults).passed is passed


def test_jitter_percentiles_and_histogram() -> None:
    late = np.arange(1001.0)
    percentiles, histogram = jitter(late)
    assert percentiles is not None
    assert histogram is not None
    found = (percentiles.p50, percentiles.p99, percentiles.p999, percentiles.max)
    assert found == pytest.approx((500, 990, 999, 1000))
    assert sum(histogram.counts) == len(late)
    assert (histogram.edges_us[0], histogram.edges_us[-1]) == (0, 1000)
    assert jitter([]) == (None, None)


def test_timing_gives_metrics() -> None:
    assert timing().metrics() == {
        "cycles_missed": 0.0,
        "jitter_p99_us": None,
        "jitter_max_us": None,
        "realtime_factor": 4.2,
        "bus_load_pct": 61.5,
        "lost_frames": None,
        "late_samples_pct": None,
    }
    assert timing([5, 5]).metrics()["jitter_max_us"] == 5


def test_no_nan_gets_into_the_file() -> None:
    with pytest.raises(ValueError, match="finite number"):
        Result.of([], {"a": float("nan")}, timing(), [])


def test_histogram_needs_matching_edges() -> None:
    with pytest.raises(ValueError, match="one edge more"):
        Histogram(edges_us=[0, 1], counts=[1, 2])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "Invalid JSON"),
        ("[]", "expected a run's result"),
        ('{"passed": true}', "criteria: Field required"),
        ('{"passed": true, "criteria": [], "metrics": {"a": "x"}, "timing": {}, "faults": []}', "metrics.a: "),
    ],
)
def test_unusable_result(tmp_path: Path, text: str, problem: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(text)
    with pytest.raises(UnusableInputError) as caught:
        Result.read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_result(tmp_path: Path) -> None:
    with pytest.raises(UnusableInputError, match="cannot be read"):
        Result.read(tmp_path / "result.json")
    with pytest.raises(UnusableInputError, match="cannot be written"):
        Result.of([], {}, timing(), []).write(tmp_path / "nowhere" / "result.json")


def test_environment_names_versions() -> None:
    here = Environment.here(seed=3)
    assert here.seed == 3
    assert here.libraries["numpy"] == np.__version__


def test_a_run_that_was_aborted_shows_what_nobody_could_judge_in_one_line(tmp_path: Path) -> None:
    fault = Fault(time_s=12.5, source="operator", text="interrupted, drives were stopped")
    result = Result.of([PASSED, FAILED, FAILED, FAILED], {}, timing(), [fault])
    console = Console(width=200, file=io.StringIO())
    show_outcome(console, RunOutcome(RunFolder(tmp_path), result, 130))
    lines = console.file.getvalue().splitlines()
    assert [line for line in lines if "noise" in line or "not there" in line] == []
    assert [line for line in lines if line.startswith("error")] == [
        "error 4 of 4 criteria could not be judged: the run ended by the fault below"
    ]
    assert "fault operator: interrupted, drives were stopped" in lines
