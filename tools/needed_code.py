"""Write src/hilbench/apps/commands/needed_code.json: the compiled functions that runs of each kind call.

Each example is run on copies of the machine code that `hilbench compile` has left; what is read of them was needed.
That goes by the time of access of the files, so that every process of a run counts.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numba.core.caching import UserProvidedCacheLocator

from hilbench.apps.commands.needed_code import Function

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "hilbench"
LIST = PACKAGE / "apps" / "commands" / "needed_code.json"
#: The examples of each kind of run.
EXAMPLES = {
    "web_line": ("web_section_step",),
    "web_line of several axes": ("line_two_spans",),
    "web_line with stations": ("line_with_dancer", "winding_line"),
    "servo_axis": ("servo_axis",),
}
_NAME = re.compile(r"(?P<stem>\w+)\.(?P<name>\w+)-\d+\.py\d+\.\d+\.nbc")


def used_by(example: str, folder: Path) -> dict[Function, int]:
    """The entry points of which runs of an example read machine code, with processes and without, with its size in
    bytes; the copies are put into `folder`. Raises CalledProcessError where the run can't be made."""
    copies: dict[Path, str] = {}
    locator: Any = UserProvidedCacheLocator
    for source in PACKAGE.rglob("*.nb[ic]"):
        package = source.parent.parent
        to = folder / locator.get_suitable_cache_subpath(str(package / "module.py"))
        to.mkdir(parents=True, exist_ok=True)
        copy = Path(shutil.copy(source, to))
        os.utime(copy, (0, copy.stat().st_mtime))
        copies[copy] = ".".join(package.relative_to(PACKAGE.parent).parts)
    command = [sys.executable, "-m", "hilbench", "run", str(ROOT / "bench_configs" / f"{example}.yaml")]
    options = ["--no-report", "--out", str(folder / "runs"), "--bus", f"embedded:needed{os.getpid()}"]
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder)}
    for alone in ([], ["--in-process"]):
        subprocess.run([*command, *options, *alone], env=environment, stdout=subprocess.DEVNULL, check=True)
    found: dict[Function, int] = {}
    for copy, room in copies.items():
        named, state = _NAME.fullmatch(copy.name), copy.stat()
        if named is not None and state.st_atime > 0:  # those in functions have no name by which they could be compiled
            found[Function(f"{room}.{named['stem']}", named["name"])] = state.st_size
    return found


def main() -> None:
    needed: dict[str, list[Function]] = {kind: [] for kind in EXAMPLES}
    if not LIST.exists():
        LIST.write_text(json.dumps(needed), encoding="utf-8")
    for kind, examples in EXAMPLES.items():
        found: dict[Function, int] = {}
        for example in examples:
            with TemporaryDirectory() as folder:
                found |= used_by(example, Path(folder))
        needed[kind] = sorted(found, key=lambda each: (-found[each], each))
        print(f"{kind}: {len(found)} functions")
    LIST.write_text(json.dumps(needed, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
