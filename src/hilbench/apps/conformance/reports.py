"""Verdicts of an examination as a page, with what was sent, expected and seen, and as JUnit XML for CI servers."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from xml.etree import ElementTree

from hilbench.apps.conformance.record import CaseResult, Examination, Step, Verdict, counted
from hilbench.apps.report.page import write_page
from hilbench.results.junit import write_suite

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
        groups=[(group, counted(cases), cases) for group, cases in groups],
        counted=counted(examination.cases),
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


def write_junit(examination: Examination, path: Path) -> None:
    """Write it. Raises UnusableInputError if it cannot be written."""
    suite = ElementTree.Element("testsuite", name=f"{examination.device} (node {examination.node_id})")
    for case in examination.cases:
        element = ElementTree.SubElement(suite, "testcase", classname=case.group, name=f"{case.name}: {case.title}")
        if case.verdict is Verdict.FAILED:
            failure = ElementTree.SubElement(element, "failure", message=case.reason)
            failure.text = "\n".join(
                f"{step.what}: sent {step.sent or 'nothing'}; expected {step.expected}; seen {step.seen}"
                for step in case.steps
                if not step.ok
            )
        elif case.verdict is not Verdict.PASSED:
            ElementTree.SubElement(element, "skipped", message=f"{case.verdict}: {case.reason}")
    write_suite(suite, path)
