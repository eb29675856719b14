"""What a tool has measured, in its place on a page of the docs: between the lines `<!-- NAME: begin -->` and `end`.

A long table (`Table`) has all its rows in docs/tables/NAME.csv; the page shows a summary of them.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1] / "docs"
#: A row of a table by its columns.
Row = dict[str, str]
#: Cells that stand to the right: numbers with a sign, a unit or a bound, and none (–).
_FIGURE = re.compile(r"[-−±+<]?\d[\d.,  ]*(e[-+]?\d+)?( ?[%×] ?)?|–|")


@dataclass(frozen=True)
class Table:
    """All rows in docs/tables/NAME.csv; a summary of them between the lines NAME of a page."""

    name: str
    page: str  #: below docs
    columns: tuple[str, ...]
    summary: Callable[[list[Row]], str]  #: Markdown, from the rows as they are in the file

    @property
    def file(self) -> Path:
        """Where the rows are."""
        return DOCS / "tables" / f"{self.name}.csv"

    def rows(self) -> list[Row]:
        """As they are in the file."""
        with self.file.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))

    def shown(self) -> str:
        """What the page has of the file."""
        link = f"tables/{self.name}.csv"
        return f"{self.summary(self.rows())}\n\nAll rows: [{link}]({link})."

    def write(self, rows: Iterable[Sequence[str]]) -> None:
        """Put rows into the file, and their summary into the page."""
        self.file.parent.mkdir(exist_ok=True)
        with self.file.open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *rows])
        put(DOCS / self.page, self.name, self.shown())


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; columns of figures stand to the right."""
    lines = [[cell.replace("|", "\\|") for cell in row] for row in rows]
    sides = ["--:" if all(_FIGURE.fullmatch(cell) for cell in cells) else "---" for cells in zip(*lines, strict=True)]
    head = [f"| {' | '.join(columns)} |", f"|{'|'.join(sides or ['---'] * len(columns))}|"]
    return "\n".join([*head, *(f"| {' | '.join(line)} |" for line in lines)])


def gathered(rows: Sequence[Row], is_good: Callable[[Row], bool]) -> str:
    """A table of counts: the rows that are not good, and the sum of all."""
    first, *counts = rows[0]
    total = [str(sum(int(row[name]) for row in rows)) for name in counts]
    lines = [list(row.values()) for row in rows if not is_good(row)]
    return markdown((first, *counts), [*lines, [f"all {len(rows)}" if lines else f"{len(rows)} rows", *total]])


def between(page: Path, name: str) -> str:
    """What stands there. Raises ValueError when the page lacks the lines."""
    return _parts(page, name)[1].strip("\n")


def put(page: Path, name: str, text: str) -> None:
    """Put `text` there. Raises ValueError when the page lacks the lines."""
    before, _, after = _parts(page, name)
    page.write_text(f"{before}\n{text}\n{after}", encoding="utf-8")


def _parts(page: Path, name: str) -> tuple[str, str, str]:
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    there, found_end, after = rest.partition(end)
    if not found or not found_end:
        raise ValueError(f"{page}: expected the lines '{begin}' and '{end}'")
    return before + begin, there, end + after
