"""The tables of docs/tables: each page shows what its tool makes of them, and leads there."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import docs_page
import pytest
from docs_page import DOCS, Table

TOOLS = Path(__file__).resolve().parents[2] / "tools"


def tables() -> list[Table]:
    """Those of all tools."""
    found: dict[str, Table] = {}
    for path in sorted(TOOLS.rglob("*.py")):
        if "docs_page.Table(" in path.read_text(encoding="utf-8"):
            module = import_module(".".join(path.relative_to(TOOLS).with_suffix("").parts))
            for value in vars(module).values():
                several = value.values() if isinstance(value, dict) else [value]
                found |= {each.name: each for each in several if isinstance(each, Table)}
    return list(found.values())


TABLES = tables()


def test_each_file_is_a_tool_s() -> None:
    assert {path.name for path in (DOCS / "tables").iterdir()} == {table.file.name for table in TABLES}


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.name)
def test_the_page_shows_what_the_tool_makes_of_the_file(table: Table) -> None:
    rows = table.rows()
    assert rows
    assert tuple(rows[0]) == table.columns
    assert docs_page.between(DOCS / table.page, table.name) == table.shown()
    assert f"](tables/{table.file.name})" in table.shown()


def test_rows_become_a_file_and_a_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs_page, "DOCS", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- lengths: begin -->\nold\n<!-- lengths: end -->\nbehind\n", encoding="utf-8")
    table = Table("lengths", "page.md", ("what", "m"), lambda rows: f"The longest: {max(row['m'] for row in rows)} m.")
    table.write([["a, b", "1.5"], ["c | d", "2"]])
    assert table.rows() == [{"what": "a, b", "m": "1.5"}, {"what": "c | d", "m": "2"}]
    assert page.read_text(encoding="utf-8") == (
        "before\n<!-- lengths: begin -->\nThe longest: 2 m.\n\nAll rows: [tables/lengths.csv](tables/lengths.csv).\n"
        "<!-- lengths: end -->\nbehind\n"
    )


def test_figures_stand_to_the_right_and_bars_stay_in_their_cells() -> None:
    made = docs_page.markdown(("what", "E, %"), [["c | d", "−1.5"], ["e", "–"]])
    assert made == "| what | E, % |\n|---|--:|\n| c \\| d | −1.5 |\n| e | – |"


def test_a_page_without_the_lines_is_refused(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# Conformance\n", encoding="utf-8")
    with pytest.raises(ValueError, match="expected the lines '<!-- conformance: begin -->'"):
        docs_page.put(page, "conformance", "")
