"""A package of somebody else beside hilbench, installed as far as imports and entry points go."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def install(folder: Path, name: str, source: str, group: str = "", **entries: str) -> None:
    """A module `name` in `folder`, with entry points by name: its attributes."""
    (folder / f"{name}.py").write_text(source)
    metadata = folder / f"{name}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{entry.replace('_', '-')} = {name}:{attribute}\n" for entry, attribute in entries.items()]
    (metadata / "entry_points.txt").write_text("".join([f"[{group}]\n", *lines] if group else []))


def hilbench_with(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """A command of a process that has what is installed in `folder`."""
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-m", "hilbench", *map(str, words)]
    return subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)
