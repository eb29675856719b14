"""Run the conformance cases and write their table: ``python tools/conformance_table.py --write docs/conformance.md``.

The list of cases is ``tests/canopen/conformance/cases.yaml``; the tests beside it name theirs by ``@case("SDO 5")``.
Nothing is written when a test fails.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "tests" / "canopen" / "conformance"
BEGIN, END = "<!-- table: tools/conformance_table.py -->\n", "<!-- end of table -->\n"


@dataclass(frozen=True)
class Case:
    """One case; `why` says why it does not apply, None when it does."""

    group: str
    number: int
    title: str
    why: str | None

    @property
    def name(self) -> str:
        """As tests name it."""
        return f"{self.group} {self.number}"


def listed_cases() -> list[Case]:
    """The list of cases in its order."""
    groups = yaml.safe_load((FOLDER / "cases.yaml").read_text(encoding="utf-8"))
    return [
        Case(group, number, entry["title"], entry.get("why"))
        for group, entries in groups.items()
        for number, entry in entries.items()
    ]


def cases_under_test() -> Iterator[str]:
    """The case of each test function, as its decorator names it."""
    for file in sorted(FOLDER.glob("test_*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            for decorator in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) in ("case", "pytest.mark.case"):
                    yield ast.literal_eval(decorator.args[0])


def table(cases: Collection[Case]) -> str:
    """What stands between the marker lines when the tests of all cases that apply have passed."""
    applied = sum(case.why is None for case in cases)
    lines = [f"{len(cases)} cases: {applied} passed, {len(cases) - applied} not applicable.\n"]
    for group, members in groupby(cases, key=lambda case: case.group):
        lines += [f"\n### {group}\n", "\n| | case | result |\n", "|---|---|---|\n"]
        lines += [f"| {case.number} | {case.title} | {_result(case)} |\n" for case in members]
    return "".join(lines)


def _result(case: Case) -> str:
    return "passed" if case.why is None else f"not applicable: {case.why}"


def with_table(page: str, text: str) -> str:
    """The page with `text` between its marker lines. Raises ValueError when they are missing."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the page lacks the lines '{BEGIN.strip()}' and '{END.strip()}'")
    return f"{before}{begin}{text}{end}{after}"


def main() -> int:
    """Exit code: 0, or pytest's."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--write", type=Path, metavar="PAGE", help="bring the table of this page up to date")
    arguments = parser.parse_args()
    result = pytest.main(["-q", "-m", "case", "--rootdir", str(ROOT), str(FOLDER)])
    if result:
        return int(result)
    text = table(listed_cases())
    if arguments.write is None:
        print(text, end="")
    else:
        arguments.write.write_text(with_table(arguments.write.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))  # the tests import their helpers from there
    sys.exit(main())
