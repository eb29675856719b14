"""`hilbench examples`, `hilbench demo`: the configs that are shipped."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option


def examples(
    names: Annotated[
        list[str] | None, Argument(metavar="[NAME]...", help="examples to copy; without one they are listed")
    ] = None,
    everything: Annotated[bool, Option("--all", help="copy all of them")] = False,
) -> None:
    """List example configs, or copy some with their EDS files to bench_configs/ and eds/ in this folder.

    A file that is there already is kept as it is. The examples of each command's --help are runs of these configs.

    Example: hilbench examples

    Example: hilbench examples web_section_step winding_line

    Example: hilbench examples --all
    """
    from hilbench.runs.examples import config_of, copy
    from hilbench.runs.examples import names as known

    wanted = known() if everything else names or ()
    for name in wanted:
        print(copy(name, Path())[0])
    if not wanted:
        from rich.console import Console
        from rich.table import Table

        from hilbench import strict_yaml

        table = Table(show_header=False, box=None, padding=(0, 2, 0, 0))
        table.add_column(no_wrap=True)
        table.add_column()
        for name in known():
            table.add_row(name, strict_yaml.load(config_of(name)).data.get("description", ""))
        Console(highlight=False).print(table)
