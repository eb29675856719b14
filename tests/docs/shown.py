"""The command lines that README and docs show, and what of them is run where.

Shown is what stands in a block of its own or, as inline code, is more than a command's name. A page's placeholders
(CONFIG, RUN, …) and the reader's buses are replaced by what the tests have.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tools.reference import commands_page

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

#: Words with which a shown line begins that is a command.
_PROGRAMS = {
    "hilbench",
    "make",
    "pytest",
    "pip",
    "python",
    "source",
    "sudo",
    "ip",
    "candump",
    "chrt",
    "taskset",
    "echo",
}

#: What is not run by the tests of the docs, and why.
NOT_RUN = {
    r"hilbench sdo read 127 operator": "needs a bench that runs: tests/bench/test_operator.py",
    r"hilbench (demo|run my_bench.yaml)": "tests/test_wheel.py runs it, in an empty folder",
    r"make (setup|wheel|demo|test|docs|bench|lint)\b": "CI runs it, or it takes longer than all tests; it is looked up",
    r"python tools/\S+": "writes the tables of a page from runs that take minutes; the tool is looked up",
    r"python -m hilbench\.(hardware|twin)$": "a bench starts them; tests/bench/test_children.py starts each alone",
    r"python -m hilbench\.live$": "a bench starts it and holds the other end: tests/live/test_live_runs.py",
    r"source \.venv/bin/activate": "changes the shell it stands in",
    r"pip install ": "loads packages",
    r"(sudo|ip|echo) ": "changes the machine, or asks an interface: the guest of `make test-vcan` has one",
    r"candump ": "needs a CAN interface: the guest of `make test-vcan` has one, and a candump as witness",
    r"hilbench --install-completion": "writes into the start-up files of the user's shell",
    r"hilbench monitor \S+ .*--browser": "serves until it is ended; tests/pages/test_in_browser.py opens it",
    r"hilbench simulate-drive ": "runs until it is ended; tests/cli/test_simulate_drive.py drives what it plays",
    r"hilbench sdo (dump|load|diff) ": "needs drives: tests/cli/test_sdo_files.py has two",
    r"hilbench (scan .*--lss|lss )": "needs devices without a node id: tests/cli/test_lss.py has two",
    r"hilbench boot ": "needs a network: tests/cli/test_boot.py has some",
    r"hilbench gateway": "runs until it is ended; tests/gateway/test_gateway.py talks to it",
    r"hilbench conformance ": "resets a node, and takes minutes: tests/cli/test_drive_and_conformance.py examines one",
    r"hilbench drive \S+ move ": "needs a drive with that mode: tests/cli/test_drive_and_conformance.py has one",
    r"hilbench drive \S+ .*--axis ": "needs a node with two axes: tests/cli/test_two_axes.py has one",
    r"hilbench run bench_configs/web_section_dual_axis.yaml": "tests/bench/test_shipped_configs.py runs it",
    r"hilbench drive \S+ jog ": "its key is held by hand; tests/cli/test_attach.py holds it",
    r"hilbench sdo write bench ": "needs a running bench; tests/bench/test_beside_a_bench.py writes to one",
    r"hilbench run bench_configs/predicted_limit.yaml": "tests/bench/test_prediction.py runs it",
    r"hilbench run bench_configs/live_servo_friction.yaml": "tests/live/test_servo_axis.py runs it",
    r"hilbench run bench_configs/live_line_friction.yaml": "tests/live/test_line_of_spans.py runs it",
    r"hilbench run bench_configs/line_three_spans.yaml": "tests/bench/test_line_three_spans.py runs it",
    r"hilbench run bench_configs/winding_line.yaml": "tests/bench/test_line_with_stations.py runs it",
    r"hilbench what-if bench_configs/": "needs a bench that runs: tests/results/test_what_if.py has one",
    r"hilbench commission ": "takes a minute: tests/history/test_commissioned.py commissions a stand",
    r"hilbench run bench_configs/probing.yaml": "tests/bench/test_probing.py runs it",
    r"hilbench run bench_configs/live_\w+.yaml": "takes minutes: tests/live/test_live_runs.py runs it",
    r"hilbench fmu ": "needs a C compiler: tests/bench/test_fmu.py and tests/plant/fmu run it where there is one",
    r"python -m zipfile -c sliding_mass\.fmu|hilbench run sliding_mass\.yaml": "needs a C compiler: tests/bench/"
    "test_sliding_mass.py does both where there is one",
    r"python -m hilbench\.plant\.fmu$": "who uses an FMU holds the other end: tests/plant/fmu/test_fmu.py",
    r"hilbench sweep .*--cluster ": "needs a cluster; tests/scripts/test_sweep.py has one of its own",
    r"hilbench sync bench_configs/synchronizers.yaml": "runs the bench once with each method, which takes minutes",
    r"hilbench run .*--stream": "writes a file, or wants a viewer: tests/streams/test_streams.py has both",
    r"hilbench runs (delete|gc --max)": "deletes runs: tests/library/test_runs_command.py has some to delete",
    r"hilbench runs matrix --reqif": "needs a specification: tests/library/test_requirements.py has one",
    r"hilbench runs trend .*--over ": "needs runs that differ: tests/library/test_runs_command.py has them",
    r"pytest --hilbench-config ": "the page's test is run by tests/scripts/test_scripts.py",
}
#: What a shown line is instead where it is run: no terminal is there, no stand, and no need for all methods.
_INSTEAD = (
    (r"(hilbench monitor \S+).*", r"\1 --json --for 0.2"),
    (r"hilbench estop$", "hilbench estop --bus embedded"),
    (r"runs/[\w.-]+?-20[\d-]+|runs/(RUN|BEFORE|AFTER)\b|\bRUN\b", "runs/RUN"),
    (r"\bRECORDING\b", "runs/RUN/recording.mf4"),
    (r"\bMODEL\b", "model.yaml"),
    (r"--eds FOLDER", "--eds eds"),
    (r"\b(FOLDER|DIR)\b", "folder"),
    (r"\bCONFIG\b", "bench_configs/web_section_step.yaml"),
    (r"socketcan:\w+", "embedded"),
    (r"(--eds eds)/my_drive.eds", r"\1"),
)


@dataclass(frozen=True)
class Shown:
    """One command line as it stands there, and the words that are run in its place (none: it is not run)."""

    place: str
    text: str
    words: tuple[str, ...]
    reason: str = ""


@cache
def shown() -> list[Shown]:
    """All of them. Raises ValueError for one of which nobody knows how it could be run."""
    lines = [
        (f"{page.relative_to(ROOT)}:{number}", text) for page in PAGES for number, text in _lines(page.read_text())
    ]
    lines += [(f"--help:{number}", text) for number, text in _lines(commands_page()) if "[OPTIONS]" not in text]
    return [_judged(place, text) for place, text in lines]


def _lines(page: str) -> Iterator[tuple[int, str]]:
    fenced = False
    for number, line in enumerate(page.splitlines(), 1):
        if line.strip().startswith("```"):
            fenced = not fenced
        elif not fenced and line.startswith("    "):
            yield from ((number, text) for text in _commands(line, block=True))
        elif not fenced:
            for found in re.findall(r"`([^`]+)`", line):
                yield from ((number, text) for text in _commands(found, block=False))


def _commands(line: str, *, block: bool) -> Iterator[str]:
    text = re.sub(r"\s+(#.*|&)$", "", re.sub(r"\s{2,}#.*$", "", line.strip()))
    text = text.replace(".venv/bin/", "") if not text.startswith("source") else text
    words = text.split()
    if words and words[0] in _PROGRAMS and len(words) > 1 and (block or words[0] != "hilbench" or _says_more(words)):
        yield text


def _says_more(words: list[str]) -> bool:
    """Whether inline code is a line to type, not only the name of a command."""
    return len(words) > 2 or words[1] not in (
        "run",
        "runs",
        "sync",
        "diagnose",
        "twin",
        "simulate-hardware",
        "drive",
        "conformance",
        "drift",
        "check",
        "commission",
    )


def _judged(place: str, text: str) -> Shown:
    for pattern, reason in NOT_RUN.items():
        if re.match(pattern, text):
            return Shown(place, text, (), reason)
    line = re.sub(r"^(taskset -c \S+ )?(chrt -f \d+ )?(?=hilbench )", "", text)  # rights that tests may not have
    line = line.replace("[", "").replace("]", "")  # of optional parts; not run without them
    for pattern, instead in _INSTEAD:
        line = re.sub(pattern, instead, line)
    words = tuple(shlex.split(line))
    if words[0] != "hilbench":
        raise ValueError(f"{place}: '{text}', expected a hilbench command, or a reason in {__name__} not to run it")
    return Shown(place, text, words[1:])
