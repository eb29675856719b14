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

        from hilbench import strict_yaml
        from hilbench.apps.cli.tables import table

        rows = [(name, strict_yaml.load(config_of(name)).data.get("description", "")) for name in known()]
        Console(highlight=False).print(table(("name", "description"), rows, ("name",), show_header=False))
