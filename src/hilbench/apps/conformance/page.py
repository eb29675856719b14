"""The page of an examination: every case with what was sent, expected and seen, and the clause."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path

from hilbench.apps.conformance.record import CaseResult, Examination, Step, Verdict
from hilbench.apps.report.page import write_page

#: Of how many steps that are as expected, and of how many that are not, a case shows the bytes.
_STEPS_SHOWN = 40


def write_conformance_page(examination: Examination, path: Path) -> Path:
    """Write the page; returns its path. Raises UnusableInputError if it cannot be written."""
    groups = [(group, list(members)) for group, members in groupby(examination.cases, key=lambda case: case.group)]
    return write_page(
        path,
        "conformance/conformance",
        [],
        title=f"Conformance of {examination.device}",
        examination=examination,
        groups=[(group, counted(case.verdict for case in cases), cases) for group, cases in groups],
        counted=counted(case.verdict for case in examination.cases),
        Verdict=Verdict,
        shown=shown,
    )


def shown(case: CaseResult) -> tuple[list[Step], int]:
    """The steps of a case that the page shows, in their order, and how many it leaves out."""
    left = {True: _STEPS_SHOWN, False: _STEPS_SHOWN}
    found = []
    for step in case.steps:
        left[step.ok] -= 1
        if left[step.ok] >= 0:
            found.append(step)
    return found, len(case.steps) - len(found)


def counted(verdicts: Iterable[Verdict]) -> str:
    """How many of each, for a person."""
    found = list(verdicts)
    return ", ".join(f"{found.count(verdict)} {verdict}" for verdict in Verdict if verdict in found)
