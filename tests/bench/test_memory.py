"""Locked memory, where it is allowed."""

from __future__ import annotations

from pathlib import Path

from hilbench.bench.memory import locked_memory


def locked_kib() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck:"))


def test_memory_is_locked_where_that_is_allowed_and_only_as_long() -> None:
    with locked_memory() as locked:
        assert (locked_kib() > 0) is locked
    assert locked_kib() == 0
