"""The tests beside this one go through cases of the list byte by byte; the table in the documentation is up to date."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from tools.conformance_table import TABLE, examined, rows

from hilbench.apps.conformance.listing import listed_cases


def cases_under_test() -> Iterator[str]:
    """The case of each test function, as its decorator names it."""
    for file in sorted(Path(__file__).parent.glob("test_*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            for decorator in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
                if isinstance(decorator, ast.Call) and ast.unparse(decorator.func) in ("case", "pytest.mark.case"):
                    yield ast.literal_eval(decorator.args[0])


def test_each_test_names_a_case_of_the_list() -> None:
    assert set(cases_under_test()) <= {case.name for case in listed_cases()}


@pytest.mark.slow
def test_the_documentation_shows_what_the_examination_of_our_drive_finds() -> None:
    found = [dict(zip(TABLE.columns, row, strict=True)) for row in rows(examined())]
    assert TABLE.rows() == found, "run tools/conformance_table.py --write"
