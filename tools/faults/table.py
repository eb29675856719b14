"""The table of faults: one row a fault, and how it went on each bus."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence

import docs_page

from faults.outcome import Row
from faults.run import Fault

COLUMNS = ("fault", "expected", "exit", "to safe state", "kept", "embedded", "vcan")


def summary(rows: list[docs_page.Row]) -> str:
    """Rows by exit code, and the longest ways to the safe state."""
    lines = []
    for bus in ("embedded", "vcan"):
        marks = [row[bus] for row in rows if row[bus] != "–"]
        others = "".join(f", {count} {mark}" for mark, count in Counter(marks).items() if mark != "✓")
        lines.append(f"{marks.count('✓')} of {len(marks)} rows pass on {bus}{others}")
    by_exit = {code: [row for row in rows if row["exit"] == code] for code in dict.fromkeys(r["exit"] for r in rows)}
    counts = [
        (code, str(len(of)), max((row["to safe state"] for row in of), key=_cycles), _outcomes(of))
        for code, of in sorted(by_exit.items(), key=lambda each: -len(each[1]))
    ]
    table = docs_page.markdown(("exit", "rows", "to safe state, longest", "expected, most often"), counts)
    return f"{'; '.join(lines)}.\n\n{table}"


def _cycles(cell: str) -> int:
    return int(cell.split()[0]) if cell != "–" else -1


def _outcomes(rows: list[docs_page.Row]) -> str:
    return "; ".join(what for what, _ in Counter(row["expected"] for row in rows).most_common(2))


TABLE = docs_page.Table("faults", "fault_tests.md", COLUMNS, summary)


def cells(row: Row, bus: str | None) -> list[str]:
    """A row of the table, its mark in the column of the bus."""
    cycles = "–" if row.cycles is None else f"{row.cycles} cycles"
    mark = "✓" if row.passed else "busy" if row.busy else "✗"
    marks = [mark, "–"] if bus is None else ["–", mark]
    return [row.fault.name, row.fault.expected, str(row.code), cycles, row.kept, *marks]


def write(made: Iterable[Sequence[str]], faults: Sequence[Fault]) -> None:
    """Put rows into the table. Of those that were made on another bus the mark alone; the other rows stay."""
    rows = {row["fault"]: list(row.values()) for row in TABLE.rows()}
    for name, *rest in made:
        *_, embedded, vcan = rest
        known = rows.get(name)
        if embedded != "–":
            rows[name] = [name, *rest[:-1], known[-1] if known else "–"]
        elif known:
            rows[name] = [*known[:-1], vcan]
    TABLE.write(rows[fault.name] for fault in faults if fault.name in rows)


def printed(text: str, faults: Sequence[Fault]) -> list[list[str]]:
    """The rows of a table in what was printed, whatever stands before them in their lines."""
    names = {fault.name for fault in faults}
    found = [text.partition("|")[2] for text in text.splitlines() if text.rstrip().endswith("|")]
    rows = [[cell.strip() for cell in text.strip().strip("|").split("|")] for text in found]
    return [row for row in rows if row[0] in names]
