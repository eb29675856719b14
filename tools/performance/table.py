"""What was measured, as rows of tables; on which machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

_HEAD = "### "
LIBRARIES = ("numba", "numpy", "scipy", "canopen", "python-can")


@dataclass(frozen=True)
class Row:
    """One figure; `ratio` says how it stands to what `against` names."""

    what: str
    value: float
    unit: str
    ratio: float | None = None
    against: str = ""


@dataclass
class Section:
    """One table, and how its figures were made."""

    title: str
    how: str
    rows: list[Row] = field(default_factory=list)

    def add(self, what: str, value: float, unit: str, ratio: float | None = None, against: str = "") -> None:
        """One more row."""
        self.rows.append(Row(what, value, unit, ratio, against))


def best_s(task: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Shortest time of so many runs, by the wall clock unless another is given."""
    times = []
    for _ in range(repeats):
        start = clock()
        task()
        times.append(clock() - start)
    return min(times)


def best_cpu_s(task: Callable[[], object], repeats: int) -> float:
    """The same in CPU time of this thread: others on the machine take less of a part in it."""
    return best_s(task, repeats, time.thread_time)


def machine() -> dict[str, str]:
    """Processor, kernel, Python, libraries, and how busy it was."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES)
    return {
        "processor": names[0] if names else platform.machine(),
        "cores": str(len(os.sched_getaffinity(0))),
        "system": f"{platform.system()} {platform.release()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "libraries": versions,
        "load average before and after": f"{os.getloadavg()[0]:.1f}",
    }


def markdown(sections: list[Section], on: dict[str, str]) -> str:
    """Tables and machine, for the page of the docs; each table says when it was made."""
    lines = ["| machine | |", "|---|---|", *(f"| {name} | {value} |" for name, value in on.items())]
    today = time.strftime("%Y-%m-%d", time.gmtime())
    for section in sections:
        lines += [
            "",
            f"{_HEAD}{section.title}",
            "",
            f"{section.how} ({today})",
            "",
            "| what | | ratio |",
            "|---|--:|---|",
        ]
        for row in section.rows:
            ratio = "" if row.ratio is None else f"{_number(row.ratio)} × {row.against}"
            lines.append(f"| {row.what} | {_number(row.value)} {row.unit} | {ratio} |")
    return "\n".join(lines)


def renewed(there: str, now: str) -> str:
    """Tables as they stand on a page with those that were measured now in their places; one that is new comes behind
    the one before it. The machine is that of now."""
    (_, old), (head, new) = _by_title(there), _by_title(now)
    titles, last = list(old), -1
    for title in new:
        if title in titles:
            last = titles.index(title)
        else:
            last += 1
            titles.insert(last, title)
    tables = [f"{_HEAD}{title}\n{(old | new)[title]}" for title in titles]
    return "\n".join([head, *tables])


def _by_title(text: str) -> tuple[str, dict[str, str]]:
    head, *tables = text.strip("\n").split(f"\n{_HEAD}")
    parts = [table.partition("\n") for table in tables]
    return head.rstrip("\n") + "\n", {title: body.rstrip("\n") + "\n" for title, _, body in parts}


def _number(value: float) -> str:
    """Three digits, without an exponent."""
    digits = max(0, 2 - (0 if value == 0.0 else int(f"{abs(value):e}".partition("e")[2])))
    return f"{value:,.{digits}f}".replace(",", " ")
