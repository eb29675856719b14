"""What was measured, as rows of tables; on which machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

import docs_page

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


COLUMNS = ("section", "how it is measured", "what", "value", "ratio", "date")
#: What the page shows of each section.
SHOWN = {
    "Model kernel, one span": ("kernel", "plain Python", "scipy solve_ivp"),
    "Model kernel, spans": ("100 spans",),
    "PDO path per cycle": ("codec", "canopen's PDO objects", "the bench's whole path"),
    "The twin, one span": ("a fast-path cycle", "a cycle by objects"),
    "Lockstep, the demo": ("speed", "speed with --in-process"),
    "Other machines, in one process": (
        "line_three_spans",
        "line_with_dancer",
        "winding_line",
        "kuhm_2012",
        "servo_axis",
    ),
    "Real time at 2 ms": ("bench, p99.9",),
    "Real time at 2 ms, priority 20": ("bench, p50", "bench, p99.9", "the wire, at worst"),
    "Real time at 1 ms, priority 20, 5 TPDOs of 3 drives": ("answers that came too late",),
    "Real time at 1 ms, priority 20, 3 TPDOs of 3 drives": ("answers that came too late",),
    "Diagnosis against length of recording": ("48 s",),
    "Start-up": ("hilbench --help", "hilbench run to first SYNC, warm", "hilbench compile"),
}


def machine_table(on: dict[str, str]) -> str:
    """On which machine, in Markdown."""
    return docs_page.markdown(("machine", ""), on.items())


def rows(sections: list[Section]) -> list[list[str]]:
    """A row a figure; each says when it was made."""
    today = time.strftime("%Y-%m-%d", time.gmtime())
    found = []
    for section in sections:
        for row in section.rows:
            ratio = "" if row.ratio is None else f"{_number(row.ratio)} × {row.against}"
            found.append([section.title, section.how, row.what, f"{_number(row.value)} {row.unit}", ratio, today])
    return found


def summary(rows: list[docs_page.Row]) -> str:
    """The most telling figures of each section."""
    shown, last = [], ""
    for row in rows:
        title = row["section"]
        if any(row["what"].partition(" (")[0] == what for what in SHOWN.get(title, ())):
            shown.append(["" if title == last else title, row["what"], row["value"], row["ratio"]])
            last = title
    return docs_page.markdown(("section", "what", "value", "ratio"), shown)


TABLE = docs_page.Table("performance", "performance.md", COLUMNS, summary)


def renewed(there: Sequence[docs_page.Row], now: list[list[str]]) -> list[list[str]]:
    """Rows as they are with the sections that were measured now in their places; one that is new comes behind the one
    before it."""
    old, new = _by_section([list(row.values()) for row in there]), _by_section(now)
    titles, last = list(old), -1
    for title in new:
        if title in titles:
            last = titles.index(title)
        else:
            last += 1
            titles.insert(last, title)
    return [row for title in titles for row in (old | new)[title]]


def _by_section(rows: list[list[str]]) -> dict[str, list[list[str]]]:
    return {title: [row for row in rows if row[0] == title] for title in dict.fromkeys(row[0] for row in rows)}


def _number(value: float) -> str:
    """Three digits, without an exponent."""
    digits = max(0, 2 - (0 if value == 0.0 else int(f"{abs(value):e}".partition("e")[2])))
    return f"{value:,.{digits}f}".replace(",", " ")
