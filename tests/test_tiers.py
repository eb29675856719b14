"""Every test is run by continuous integration, whatever its markers: what one command leaves out another one runs."""

from __future__ import annotations

import itertools
import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
#: Markers by which commands choose tests.
TIERS = ("slow", "docs", "vcan")


def _choice(words: list[str]) -> str | None:
    """The expression behind the last -m of pytest's options."""
    return next((after for word, after in reversed(list(itertools.pairwise(words))) if word == "-m"), None)


def _by_default() -> str:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]["addopts"]
    choice = _choice(shlex.split(options))
    assert choice is not None
    return choice


def _of_the_guest() -> str:
    text = (ROOT / "tools" / "test_vcan.py").read_text()
    choice = _choice(re.findall(r'"([^"]*)"', re.findall(r"^TESTS = \[(.*)\]$", text, re.MULTILINE)[0]))
    assert choice is not None
    return choice


@pytest.fixture(scope="module")
def choices() -> dict[str, str]:
    """Which tests each command of .ci/run chooses that calls pytest."""
    found = {}
    for target in re.findall(r"^ *(?:make|tested) ([\w-]+)", (ROOT / ".ci" / "run").read_text(), re.MULTILINE):
        done = subprocess.run(["make", "-n", target], cwd=ROOT, capture_output=True, text=True, check=True)
        for words in (shlex.split(line, comments=True) for line in done.stdout.splitlines() if "-m pytest" in line):
            found[target] = _choice(words[words.index("pytest") :]) or _by_default()
        if "tools/test_vcan.py" in done.stdout:
            found[target] = _of_the_guest()
    return found


@pytest.mark.parametrize(
    "marks", [marks for size in range(len(TIERS) + 1) for marks in itertools.combinations(TIERS, size)]
)
def test_continuous_integration_runs_tests_with_any_markers(marks: tuple[str, ...], choices: dict[str, str]) -> None:
    has = {tier: tier in marks for tier in TIERS}
    chosen_by = [target for target, choice in choices.items() if eval(choice, {"__builtins__": {}}, has)]
    assert chosen_by, f"no command of .ci/run runs a test with the markers {marks}: {choices}"
    wanted = {(): ["test"], ("slow",): ["test-slow"]}.get(marks, chosen_by)
    assert chosen_by == wanted  # the two parts of the suite: no test is run by both
