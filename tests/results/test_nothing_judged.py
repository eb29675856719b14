"""What a run says that nothing judges, that was cut off, or whose Python step leaves the program: never "passed"."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from tests.bench.whole_runs import config, run_folders
from tests.cli.in_process import hilbench

from hilbench.apps.scripts.bench import Bench
from hilbench.bench.lifecycle.participants import Participants
from hilbench.results.result import Result

SHORT = [{"hold": {"duration_s": 0.1}}]
BUS_LOAD = [{"name": "bus load", "metric": "bus_load_pct", "max": 100.0}]


def run(path: Path, *options: str) -> tuple[int, str, dict[str, Any]]:
    """Exit code, what was said, and the result of a run in this process."""
    done = hilbench("run", path, "--in-process", "--no-report", "--out", path.parent / "runs", *options)
    return done.returncode, done.stdout + done.stderr, json.loads((run_folders(path)[-1] / "result.json").read_text())


def test_a_run_without_criteria_is_completed_and_not_passed(tmp_path: Path) -> None:
    code, said, result = run(config(tmp_path, steps=SHORT))
    assert (code, result["passed"]) == (0, None)
    assert "completed, nothing judged" in said
    (folder,) = run_folders(tmp_path / "bench.yaml")
    cases = ElementTree.parse(folder / "result.xml").getroot()
    assert [case.get("message") for case in cases.iter("skipped")] == ["completed, nothing judged"]
    listed = json.loads(hilbench("runs", "list", "--runs", tmp_path / "runs", "--json").stdout)
    assert [run["result"] for run in listed["runs"]] == ["completed"]
    hilbench("report", folder)
    assert "Completed, nothing judged" in (folder / "report.html").read_text()


def test_a_ci_that_requires_criteria_sees_a_failure_where_there_are_none(tmp_path: Path) -> None:
    code, said, _ = run(config(tmp_path, steps=SHORT), "--require-criteria")
    assert code == 1
    assert "expected at least one criterion (--require-criteria)" in said
    code, _, result = run(config(tmp_path, steps=SHORT, criteria=BUS_LOAD), "--require-criteria")
    assert (code, result["passed"]) == (0, True)


@pytest.mark.parametrize("ends", ["sys.exit(0)", "sys.exit(7)", "sys.exit('enough')", "raise BaseException('enough')"])
def test_a_python_step_that_leaves_the_program_is_a_fault_and_no_criterion_passed(tmp_path: Path, ends: str) -> None:
    (tmp_path / "step.py").write_text(f"import sys\ndef run(bench):\n    yield\n    {ends}\n")
    steps = [*SHORT, {"python": {"file": "step.py", "function": "run"}}]
    code, said, result = run(config(tmp_path, steps=steps, criteria=BUS_LOAD))
    assert (code, result["passed"]) == (3, False)
    assert f"{tmp_path / 'step.py'}:4: " in result["faults"][0]["text"]
    assert "Traceback" not in said
    (criterion,) = result["criteria"]
    assert (criterion["passed"], criterion["value"]) == (False, None)
    assert criterion["reason"].startswith("not judged: the run was cut off, ")


@pytest.mark.parametrize(("code", "passed"), [(0, None), (None, None), (7, False), ("enough", False)])
def test_a_script_that_leaves_the_program_with_an_error_is_a_fault(
    tmp_path: Path, code: int | str | None, passed: bool | None
) -> None:
    path = config(tmp_path)

    def script() -> None:
        with Bench(path, participants=Participants.IN_PROCESS, out=tmp_path / "runs") as bench:
            bench.run(0.1)
            sys.exit(code)

    with pytest.raises(SystemExit):
        script()
    (folder,) = run_folders(path)
    assert Result.read(folder / "result.json").passed is passed


@pytest.mark.parametrize("ends", ["sys.exit(0)", "sys.exit(7)", "raise BaseException('enough')"])
def test_a_python_file_that_leaves_the_program_is_unusable_input(tmp_path: Path, ends: str) -> None:
    (tmp_path / "step.py").write_text(f"import sys\n{ends}\n")
    path = config(tmp_path, steps=[{"python": {"file": "step.py", "function": "run"}}])
    done = hilbench("run", path, "--in-process", "--out", tmp_path / "runs")
    assert done.returncode == 2
    assert done.stderr.startswith(f"hilbench: {tmp_path / 'step.py'}:2: ")
    assert len(done.stderr.splitlines()) == 1
