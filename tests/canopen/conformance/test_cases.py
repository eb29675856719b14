"""The list of conformance cases, the tests that name them and the table in the documentation agree."""

from __future__ import annotations

import pytest
from tools.conformance_table import ROOT, cases_under_test, listed_cases, table, with_table

CASES = listed_cases()
SIZES = {
    "EDS": 1,
    "SDO": 30,
    "PDO": 33,
    "OD": 9,
    "EMCY": 6,
    "SYNC": 10,
    "Guarding": 6,
    "Heartbeat": 7,
    "Heartbeat and guarding": 7,
    "Store and restore": 10,
    "NMT": 8,
}


def test_the_list_is_whole() -> None:
    numbers = {group: [case.number for case in CASES if case.group == group] for group in SIZES}
    assert numbers == {group: list(range(1, size + 1)) for group, size in SIZES.items()}
    assert len(CASES) == 127


def test_each_case_has_a_test_or_a_reason() -> None:
    assert sorted(set(cases_under_test())) == sorted(case.name for case in CASES if case.why is None)


def test_the_documentation_shows_the_list() -> None:
    page = (ROOT / "docs" / "conformance.md").read_text(encoding="utf-8")
    assert page == with_table(page, table(CASES)), "run tools/conformance_table.py --write docs/conformance.md"


def test_a_page_without_a_place_for_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="lacks the lines"):
        with_table("# Conformance\n", table(CASES))
