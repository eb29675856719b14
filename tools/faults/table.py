"""The table in docs/faults.md: one row a fault, and how it went on each bus."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import docs_page

from faults.outcome import Row
from faults.run import Fault

PLACE = "table"
HEAD = ["| fault | expected | exit | to safe state | kept | embedded | vcan |", "|---|---|---|---|---|---|---|"]


def line(row: Row, bus: str | None) -> str:
    """A row of the table in Markdown, its mark in the column of the bus."""
    cycles = "–" if row.cycles is None else f"{row.cycles} cycles"
    mark = "✓" if row.passed else "busy" if row.busy else "✗"
    marks = f"{mark} | –" if bus is None else f"– | {mark}"
    return f"| {row.fault.name} | {row.fault.expected} | {row.code} | {cycles} | {row.kept} | {marks} |"


def write(page: Path, made: Iterable[str], faults: Sequence[Fault]) -> None:
    """Put rows into the page. Of those that were made on another bus the mark alone; the other rows stay."""
    there = docs_page.between(page, PLACE).splitlines()
    rows = {cells[0]: cells for cells in map(_cells, there)}
    for cells in map(_cells, made):
        name, *_, embedded, vcan = cells
        known = rows.get(name)
        if embedded != "–":
            rows[name] = [*cells[:-1], known[-1] if known else "–"]
        elif known:
            rows[name] = [*known[:-1], vcan]
    names = [fault.name for fault in faults if fault.name in rows]
    docs_page.put(page, PLACE, "\n".join([*HEAD, *("| " + " | ".join(rows[name]) + " |" for name in names)]))


def printed(text: str, faults: Sequence[Fault]) -> list[str]:
    """The rows of a table in what was printed, whatever stands before them in their lines."""
    names = {fault.name for fault in faults}
    found = ["|" + text.partition("|")[2] for text in text.splitlines() if text.rstrip().endswith("|")]
    return [text for text in found if _cells(text)[0] in names]


def _cells(text: str) -> list[str]:
    return [cell.strip() for cell in text.strip().strip("|").split("|")]
