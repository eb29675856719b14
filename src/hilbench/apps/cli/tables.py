"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from rich.table import Table


def table(
    columns: Iterable[str],
    rows: Iterable[Iterable[str]],
    whole: Collection[str] = (),
    framed: bool = False,
    **look: Any,
) -> Table:
    """A table; `>` before a heading sets its column flush right. The columns `whole` are not wrapped; `look` is what
    rich takes."""
    shown = Table(title_justify="left", **({} if framed else {"box": None, "padding": (0, 2, 0, 0)}) | look)
    for column in columns:
        kept: Any = {"no_wrap": True} if column in whole else {"overflow": "fold"}
        shown.add_column(column.removeprefix(">"), justify="right" if column[:1] == ">" else "left", **kept)
    for row in rows:
        shown.add_row(*row)
    return shown
