"""`result.xml`: the verdict of a run as JUnit XML, one test case a criterion, for CI servers."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree

from hilbench.files import written_whole
from hilbench.results.result import Result
from hilbench.runs.criteria import CriterionResult


def write_junit(result: Result, name: str, started: datetime, path: Path) -> None:
    """Write it; `name` is the bench's. Raises UnusableInputError if it cannot be written."""
    suite = ElementTree.Element("testsuite", name=name, timestamp=started.strftime("%Y-%m-%dT%H:%M:%S"))
    for criterion in result.criteria:
        _add_criterion(suite, name, criterion)
    _add_run(suite, name, result)
    if result.verdict == "completed":
        case = ElementTree.SubElement(suite, "testcase", classname=name, name="criteria")
        ElementTree.SubElement(case, "skipped", message="completed, nothing judged")
    bus_s = result.timing.cycles * result.timing.cycle_us * 1e-6
    suite.set("time", f"{bus_s:.3f}")
    write_suite(suite, path)


def write_suite(suite: ElementTree.Element, path: Path) -> None:
    """Write test cases with the counts of their verdicts. Raises UnusableInputError if they cannot be written."""
    suite.set("tests", str(len(suite)))
    for kind, counted in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
        suite.set(counted, str(len(suite.findall(f"testcase/{kind}"))))
    ElementTree.indent(suite)
    with written_whole(path) as partial:
        partial.write_bytes(ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True) + b"\n")


def _add_criterion(suite: ElementTree.Element, name: str, criterion: CriterionResult) -> None:
    case = ElementTree.SubElement(suite, "testcase", classname=name, name=criterion.name)
    if criterion.verifies:
        properties = ElementTree.SubElement(case, "properties")
        for requirement in criterion.verifies:
            ElementTree.SubElement(properties, "property", name="verifies", value=requirement)
    value = "no value" if criterion.value is None else f"{criterion.value:.6g} {criterion.unit}".strip()
    text = f"{value}, limit {criterion.limit} {criterion.unit}".strip()
    if criterion.verdict == "error":
        ElementTree.SubElement(case, "error", message=criterion.reason or text)
    elif criterion.verdict == "failed":
        ElementTree.SubElement(case, "failure", message=f"{text}: {criterion.reason}" if criterion.reason else text)
    else:
        ElementTree.SubElement(case, "system-out").text = text + (", marginal" if criterion.marginal else "")


def _add_run(suite: ElementTree.Element, name: str, result: Result) -> None:
    """The run itself: a fault is an error of the bench, whatever the criteria say."""
    case = ElementTree.SubElement(suite, "testcase", classname=name, name="the run ends without a fault")
    for fault in result.faults:
        when = "" if fault.time_s is None else f"t = {fault.time_s:g} s, "
        ElementTree.SubElement(case, "error", message=f"{when}{fault.source}: {fault.text}")
