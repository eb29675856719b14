"""A tension loop that stays open while tension is asked for is told, in a run, a script and the report, with why."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.bench.whole_runs import config, run_folders
from tests.cli.in_process import hilbench

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants

#: A deviation of E that no twin has.
NEVER = {"tension_control": {"twin_deviation_limit_pct": 1e-6}}
SHORT_LIMIT = {"loop_open_s": 1.0}
TOLD = "tension loop open for 1.0 s while tension is asked for, axis 1 follows the ratio of speeds: the deviation of E"
MOVING = [
    {"ramp": {"path": "line_speed_m_s", "to": 2.0, "duration_s": 0.4}},
    {"hold": {"duration_s": 1.5}},
    {"step": {"path": "tension_control.set_point_N", "to": 90.0}},
    {"hold": {"duration_s": 1.5}},
]
CRITERIA = [
    {"name": "tension", "metric": "tension_final_error_N", "max": 50.0},
    {"name": "set-point", "metric": "tension_overshoot_pct", "max": 50.0},
    {"name": "E", "metric": "E_final_error_pct", "max": 50.0},
]


def test_a_run_whose_loop_never_closes_warns_and_judges_no_tension(tmp_path: Path) -> None:
    path = config(tmp_path, controllers=NEVER, safety=SHORT_LIMIT, steps=MOVING, criteria=CRITERIA)
    done = hilbench("run", path, "--in-process", "--out", tmp_path / "runs")
    assert done.returncode == 1
    assert TOLD in done.stdout
    (folder,) = run_folders(path)
    result = json.loads((folder / "result.json").read_text())
    (warning,) = [each for each in result["warnings"] if each["source"] == "tension"]
    assert (warning["count"], warning["time_s"]) == (1, pytest.approx(1.0, abs=0.2))
    assert [row["passed"] for row in result["criteria"]] == [False, False, True]
    assert [row["value"] for row in result["criteria"][:2]] == [None, None]
    assert "the tension loop was open for long" in result["criteria"][0]["reason"]
    assert "tension loop open for 1.0 s" in (folder / "report.html").read_text()


def test_a_script_hears_of_a_loop_that_never_closes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = config(tmp_path, controllers=NEVER, safety=SHORT_LIMIT)
    with Bench(path, participants=Participants.IN_PROCESS) as bench:
        bench.ramp("line_speed_m_s", 2.0, 0.4)
        bench.run(1.2)
        (said,) = capsys.readouterr().err.splitlines()
        assert said.startswith("hilbench: t = 1.090 s: tension: ")
        assert TOLD in said
        bench.step("tension_control.set_point_N", 90.0)
        bench.run(1.2)
        assert (
            bench.judge().not_judged()["tension_recovery_s"] == "the tension loop was open for long, see the warnings"
        )


def test_at_a_standstill_nothing_is_missed_until_the_set_point_is_stepped(tmp_path: Path) -> None:
    path = config(tmp_path, controllers=NEVER, safety=SHORT_LIMIT)
    with Bench(path, participants=Participants.IN_PROCESS) as bench:
        bench.run(1.5)
        assert [notice for notice in bench.notices if notice.source == "tension"] == []
        bench.step("tension_control.set_point_N", 90.0)
        bench.run(1.5)
        (told,) = [notice for notice in bench.notices if notice.source == "tension"]
        assert told.time_s == pytest.approx(2.5, abs=0.2)


def test_tension_is_judged_again_once_the_loop_has_closed(tmp_path: Path) -> None:
    path = config(tmp_path, safety=SHORT_LIMIT, twin={"web_at_rest": "unknown"})
    with Bench(path, participants=Participants.IN_PROCESS) as bench:
        bench.set("tension_control.set_point_N", 85.0)  # nothing is known at a standstill
        bench.run(1.5)
        bench.ramp("line_speed_m_s", 2.0, 0.4)
        bench.run(2.0)
        bench.step("tension_control.set_point_N", 90.0)
        bench.run(2.0)
        opened, closed = [
            event for event in bench.judge().events if "for long" in event.text or "after long" in event.text
        ]
        assert (opened.text, closed.text) == ("tension loop open for long", "tension loop closed after long")
        assert bench.judge().metrics()["tension_final_error_N"] < 1.0
