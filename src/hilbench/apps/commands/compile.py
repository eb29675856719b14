"""`hilbench compile`: the machine code that runs need, before anybody waits for it."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Annotated

from typer import Option

import hilbench

_PACKAGE = Path(str(hilbench.__file__)).parent


def compile_entry_points(
    jobs: Annotated[int | None, Option(min=1, metavar="N", help="so many processes", show_default="one a core")] = None,
) -> None:
    """Compile what Python calls of compiled functions, where that has not been done since the last change.

    The machine code goes to the folder of hilbench itself; where that can't be written to the user's cache, and to
    NUMBA_CACHE_DIR where that is set. It is for every processor of this architecture. A run
    compiles what it needs itself.

    Example: hilbench compile
    """
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    rooms = [[(module, "") for module in modules] for modules in modules_by_room()]
    # What is in one room calls the same functions, which a process compiles once.
    processes = min(jobs or os.cpu_count() or 1, len(rooms))
    with ProcessPoolExecutor(processes, get_context("spawn"), initializer=end_with_parent) as pool:
        done = [count for counts in pool.map(compile_functions, rooms) for count in counts]
    print(f"{len(done)} functions, {sum(done)} of them compiled")


def modules_by_room() -> list[list[str]]:
    """The modules with entry points, by room; that with most to read first, as it takes longest."""
    rooms: dict[str, list[Path]] = {}
    for path in sorted(_PACKAGE.rglob("*.py")):
        if re.search(r"^ *@entry_point", path.read_text(encoding="utf-8"), re.MULTILINE):
            rooms.setdefault(path.relative_to(_PACKAGE).parts[0], []).append(path)
    by_size = sorted(rooms.values(), key=lambda paths: -sum(path.stat().st_size for path in paths))
    return [[_module(path) for path in paths] for paths in by_size]


def _module(path: Path) -> str:
    parts = path.relative_to(_PACKAGE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def end_with_parent() -> None:
    """A process that compiles for nobody ends, also when `hilbench compile` was killed."""
    from multiprocessing import parent_process
    from threading import Thread

    parent = parent_process()
    assert parent is not None, "it was started by one"

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, name="parent", daemon=True).start()


def compile_functions(wanted: Sequence[tuple[str, str]]) -> list[int]:
    """Compile entry points, each by its module and name ("": all of the module); 1 for each that had to be compiled, 0
    for one that was found."""
    from hilbench.compiled import entry_points

    compiled = []
    for module, name in wanted:
        for each in entry_points(import_module(module)):
            if name in ("", each.py_func.__name__):
                each.compile(each.arguments)
                compiled.append(sum(each.stats.cache_misses.values()))
    return compiled
