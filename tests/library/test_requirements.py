"""Requirements: named by criteria, in the result and JUnit, in a matrix by runs, with the titles of a specification."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from datetime import UTC, datetime
from pathlib import Path

import pytest
from tests.cli.in_process import hilbench
from tests.library.made_runs import criterion, made_run

from hilbench.apps.library.matrix import Requirement, matrix_of, read_reqif
from hilbench.apps.library.query import Library
from hilbench.errors import UnusableInputError
from hilbench.results.junit import write_junit
from hilbench.results.result import Fault, Result, Timing
from hilbench.runs.criteria import Criterion, evaluate

SPECIFICATION = Path(__file__).parent / "specification.reqif"


def test_a_criterion_carries_its_requirements_into_result_and_junit(tmp_path: Path) -> None:
    asked = Criterion(name="E found", metric="E_noise_pct", max=0.3, verifies=["REQ-12", "REQ-7"])
    (found,) = evaluate([asked], {"E_noise_pct": 0.1})
    timing = Timing(
        pace="lockstep", cycle_us=2000, cycles=1, missed=0, jitter_us=None, realtime_factor=None, bus_load_pct=None
    )
    result = Result.of([found], {}, timing, [])
    assert json.loads(result.model_dump_json())["criteria"][0]["verifies"] == ["REQ-12", "REQ-7"]
    write_junit(result, "bench", datetime(2026, 3, 1, tzinfo=UTC), tmp_path / "result.xml")
    case = ET.parse(tmp_path / "result.xml").getroot()[0]
    properties = [(each.get("name"), each.get("value")) for each in case.findall("properties/property")]
    assert properties == [("verifies", "REQ-12"), ("verifies", "REQ-7")]


def test_a_criterion_without_a_requirement_says_nothing_of_one() -> None:
    (found,) = evaluate([Criterion(name="E found", metric="E_noise_pct", max=0.3)], {"E_noise_pct": 0.1})
    assert "verifies" not in json.loads(found.model_dump_json())


def matrix_in(folder: Path, *specified: Requirement) -> dict[str, list[str]]:
    made = matrix_of(Library(folder).runs(), specified)
    return {row.requirement.id: list(row.cells) for row in made.rows}


def test_a_matrix_has_what_each_run_says_of_each_requirement(tmp_path: Path) -> None:
    made_run(tmp_path, number=1, criteria=[criterion("a", verifies=["R1", "R2"]), criterion("b", verifies=["R1"])])
    made_run(tmp_path, number=2, criteria=[criterion("a", passed=False, verifies=["R1"])])
    made_run(tmp_path, number=3, criteria=[criterion("c")])  # verifies nothing: no column
    assert matrix_in(tmp_path) == {"R1": ["failed", "passed"], "R2": ["", "passed"]}


def test_the_worst_of_several_criteria_counts(tmp_path: Path) -> None:
    made_run(tmp_path, criteria=[criterion("a", verifies=["R1"]), criterion("b", passed=False, verifies=["R1"])])
    assert matrix_in(tmp_path) == {"R1": ["failed"]}


def test_a_run_with_a_fault_verifies_nothing(tmp_path: Path) -> None:
    fault = Fault(time_s=1.0, source="bench", text="node 3 is gone")
    made_run(tmp_path, criteria=[criterion("a", verifies=["R1"])], faults=[fault])
    assert matrix_in(tmp_path) == {"R1": ["fault"]}
    assert not matrix_of(Library(tmp_path).runs()).fulfilled


def test_a_requirement_that_no_criterion_verifies_is_not_covered(tmp_path: Path) -> None:
    made_run(tmp_path, criteria=[criterion("a", verifies=["R2"])])
    made = matrix_of(Library(tmp_path).runs(), [Requirement("R1", "Stops"), Requirement("R2", "Finds E")])
    assert made.not_covered == [Requirement("R1", "Stops")]
    assert [row.newest for row in made.rows] == ["", "passed"]
    assert not made.fulfilled


def test_a_specification_is_read_with_its_titles_and_without_its_headings() -> None:
    assert read_reqif(SPECIFICATION) == [
        Requirement("REQ-12", "E is found within 0.2 s of a step"),
        Requirement("REQ-7", "The web does not break & stays below 160 N"),
        Requirement("_r3", "The stand stops within a second"),
    ]


@pytest.mark.parametrize("text", ["", "<html/>", "no xml", "<REQ-IF/>"])
def test_what_is_no_specification_is_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "specification.reqif"
    path.write_text(text)
    with pytest.raises(UnusableInputError) as caught:
        read_reqif(path)
    assert "\n" not in str(caught.value)


def test_the_matrix_as_one_types_it(tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    made_run(runs, number=1, criteria=[criterion("E in time", verifies=["REQ-12"])])
    assert hilbench("runs", "matrix", "--runs", runs).returncode == 0
    words = ["runs", "matrix", "--reqif", SPECIFICATION, "--runs", runs]
    done = hilbench(*words)
    assert done.returncode == 1
    rows = {line.split()[0]: line for line in done.stdout.splitlines() if line.startswith(("REQ", "_r"))}
    assert "E is found within 0.2 s of a step" in rows["REQ-12"]
    assert "passed" in rows["REQ-12"]
    assert "not covered" in rows["REQ-7"]
    data = json.loads(hilbench(*words, "--json").stdout)
    assert [each["covered"] for each in data["requirements"]] == [True, False, False]
    page = tmp_path / "matrix.html"
    hilbench(*words, "--html", page)
    assert "The web does not break &amp; stays below 160 N" in page.read_text()
