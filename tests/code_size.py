"""Size of the code by package: lines, compiled functions, entry points of machine code, index constants; words of docs.

    python -m tests.code_size

prints the table. Compiled are functions with one of numba's decorators of `hilbench.compiled`; index constants are the
names of `A, B, C = range(n)`.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from dataclasses import astuple, dataclass, fields
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "src" / "hilbench"
DOCS = ROOT / "docs"
_COMPILED = {"compiled", "inlined", "merged"}


@dataclass
class Size:
    """Counts of one package, or of all."""

    lines: int = 0
    compiled: int = 0
    entry_points: int = 0
    indices: int = 0

    def __iadd__(self, other: Size) -> Size:
        for each in fields(self):
            setattr(self, each.name, getattr(self, each.name) + getattr(other, each.name))
        return self


def size_of(source: str) -> Size:
    """Counts of one module."""
    size = Size(lines=source.count("\n"))
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef):
            names = {_name(decorator) for decorator in node.decorator_list}
            size.entry_points += "entry_point" in names
            size.compiled += bool(names & {*_COMPILED, "entry_point"})
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and _name(node.value) == "range":
            size.indices += sum(len(t.elts) for t in node.targets if isinstance(t, ast.Tuple | ast.List))
    return size


def _name(node: ast.expr) -> str:
    called = node.func if isinstance(node, ast.Call) else node
    return called.id if isinstance(called, ast.Name) else called.attr if isinstance(called, ast.Attribute) else ""


def by_package() -> dict[str, Size]:
    """Counts by package, single modules together as ``(top)``."""
    found: dict[str, Size] = defaultdict(Size)
    for path in sorted(SOURCES.rglob("*.py")):
        parts = path.relative_to(SOURCES).parts
        found[parts[0] if len(parts) > 1 else "(top)"] += size_of(path.read_text(encoding="utf-8"))
    return found


def total() -> Size:
    """Counts of all packages."""
    size = Size()
    for each in by_package().values():
        size += each
    return size


def words_of_docs() -> int:
    """Words of the pages in docs."""
    return sum(len(path.read_text(encoding="utf-8").split()) for path in DOCS.rglob("*.md"))


if __name__ == "__main__":
    rows = sorted(by_package().items(), key=lambda row: -row[1].lines)
    print(f"{'package':18}" + "".join(f"{each.name:>14}" for each in fields(Size)))
    for name, size in (*rows, ("all", total())):
        print(f"{name:18}" + "".join(f"{value:14}" for value in astuple(size)))
    print(f"docs: {words_of_docs()} words")
