"""The verdicts as JUnit XML, one test case a case of the list, for CI servers."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from hilbench.apps.conformance.record import CaseResult, Examination, Verdict
from hilbench.files import written_whole


def write_junit(examination: Examination, path: Path) -> None:
    """Write it. Raises UnusableInputError if it cannot be written."""
    suite = ElementTree.Element("testsuite", name=f"{examination.device} (node {examination.node_id})")
    for case in examination.cases:
        _add(suite, case)
    counts = examination.counts
    suite.set("tests", str(len(suite)))
    suite.set("failures", str(counts[Verdict.FAILED]))
    suite.set("errors", "0")
    suite.set("skipped", str(counts[Verdict.NOT_APPLICABLE] + counts[Verdict.NOT_ALLOWED]))
    ElementTree.indent(suite)
    with written_whole(path) as partial:
        partial.write_bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True) + b"\n")


def _add(suite: ElementTree.Element, case: CaseResult) -> None:
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
