"""`hilbench history`: what runs have found of a stand's machine, how it changes, and when a limit will be reached."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from typer import Argument, Option

from hilbench.apps.cli.options import JsonOption, key_and_number, print_json
from hilbench.apps.cli.tables import table
from hilbench.errors import UnusableInputError

if TYPE_CHECKING:
    from hilbench.apps.history.quantities import QuantityTrend

#: Columns that the table needs; a narrower terminal wraps whole lines, it loses no figures.
_WIDTH = 120


def history(
    config: Annotated[
        Path | None, Argument(metavar="[CONFIG]", help="bench config (YAML): its stand, history and wear_limits")
    ] = None,
    file: Annotated[
        Path | None, Option(help="history file", show_default="the config's, or history.sqlite beside --runs")
    ] = None,
    stand: Annotated[
        str | None, Option(help="name of the stand", show_default="the config's, or all of the file")
    ] = None,
    limit: Annotated[
        list[str] | None,
        Option(metavar="QUANTITY=VALUE", help="a value of which it is asked when it is reached; repeatable"),
    ] = None,
    html: Annotated[Path | None, Option(help="write a page with pictures")] = None,
    rebuild: Annotated[
        bool, Option("--rebuild", help="first make the history anew from the run folders in --runs")
    ] = False,
    runs: Annotated[Path, Option(help="folder with the run folders; their history lies beside it")] = Path("runs"),
    json: JsonOption = False,
) -> None:
    """Show what the runs of a stand have found of its machine: level, trend, changes, and when a limit is reached.

    Every run adds what its twin estimated, every diagnosis of a run the effects that it found.

    Example: hilbench history

    Example: hilbench history bench_configs/web_section_step.yaml --limit web.youngs_modulus_Pa=9e9 --html history.html

    Example: hilbench history --rebuild --runs runs --json
    """
    from hilbench.apps.history import entries
    from hilbench.apps.history.quantities import as_data, quantities_of
    from hilbench.apps.history.store import History, history_beside, history_of
    from hilbench.runs.config import load

    bench = None if config is None else load(config)[0]
    path = file or (history_beside(runs) if bench is None else history_of(bench, runs))
    stand = stand or (None if bench is None else bench.stand_name)
    expected = "QUANTITY=VALUE such as shaft.inertia_kg_m2=0.02"
    limits = dict(key_and_number("--limit", text, expected) for text in limit or ())
    problems = entries.rebuild(path, stand, runs) if rebuild else []
    known = History(path).stands()
    if stand is not None and stand not in known:
        raise UnusableInputError(path, f"knows no stand '{stand}', expected one of: {', '.join(known) or 'none yet'}")
    shown = {name: History(path).rows(name) for name in ([stand] if stand else known)}
    if len(shown) > 1 and limits:
        raise UnusableInputError("--limit", f"for {len(shown)} stands, expected --stand with one of {', '.join(known)}")
    for name, value in ({} if bench is None else bench.wear_limits).items():
        if any(row.quantity.name == name for rows in shown.values() for row in rows):
            limits.setdefault(name, value)
        else:
            problems.append(f"wear_limits: no run has found '{name}' yet")
    found = {name: list(quantities_of(rows, limits)) for name, rows in shown.items()}
    if html is not None:
        from hilbench.apps.history.page import write_history_page

        write_history_page(found, html)
    if json:
        stands = [{"stand": name, "quantities": [as_data(each) for each in of]} for name, of in found.items()]
        print_json({"file": str(path), "stands": stands, "notes": problems})
        return
    _show(found, path, problems, html)


def _show(found: dict[str, list[QuantityTrend]], path: Path, problems: Sequence[str], html: Path | None) -> None:
    from hilbench.apps.history.quantities import COLUMNS, figures, sentences

    console = Console(highlight=False)
    console.width = max(console.width, _WIDTH)
    for name, quantities in found.items():
        columns = [column.lower() for column in COLUMNS]
        console.print(table(columns, map(figures, quantities), columns, title=f"{name}  ({path})"))
        for one in quantities:
            for line in sentences(one):
                console.print(f"{one.name}: {line}", soft_wrap=True, markup=False)
    for problem in problems:
        console.print(f"note: {problem}", soft_wrap=True, markup=False)
    if html is not None:
        console.print(f"page: {html}", soft_wrap=True, markup=False)
