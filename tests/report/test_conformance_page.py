"""The page of an examination."""

from __future__ import annotations

from pathlib import Path

from hilbench.apps.conformance.record import CaseResult, Examination, Step, Verdict
from hilbench.apps.conformance.reports import shown, write_conformance_page


def step(number: int, *, ok: bool) -> Step:
    return Step(f"step {number}", f"605 {number:02x}", "585 <60>", "585 80", ok)


def case(steps: list[Step], verdict: Verdict = Verdict.FAILED) -> CaseResult:
    return CaseResult("SDO", 5, "Read nothing & more", "CiA 301, table 22", verdict, "why", steps, ["a note"])


def test_a_failed_case_shows_its_steps_in_their_order_with_bytes_and_clause(tmp_path: Path) -> None:
    failed = case([step(1, ok=True), step(2, ok=False), step(3, ok=True)])
    examination = Examination("drive <A>", 5, "socketcan:can0", "drive.eds", [failed])
    text = write_conformance_page(examination, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Conformance of drive &lt;A&gt;" in text
    assert "1 failed" in text
    part = text[text.index("<h2>Failed</h2>") :]
    assert part.index("step 1") < part.index("step 2") < part.index("step 3")
    assert '<tr class="wrong"><td>✗</td><td>step 2</td><td><code>605 02</code></td>' in part
    for told in ("585 &lt;60&gt;", "CiA 301, table 22", "a note", "Read nothing &amp; more"):
        assert told in part


def test_of_many_steps_those_that_failed_are_shown_first_of_all() -> None:
    found, left_out = shown(case([*[step(number, ok=True) for number in range(100)], step(100, ok=False)]))
    assert (len(found), left_out) == (41, 60)
    assert found[-1].what == "step 100"
