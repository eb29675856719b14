"""Every command line of README, docs and --help is one that exists; `make docs` runs them (test_commands_run.py)."""

from __future__ import annotations

import re

import pytest
import typer
from tests.docs.shown import NOT_RUN, ROOT, Shown, shown

from hilbench.apps.cli.main import command_line

LINES = shown()
HILBENCH = typer.main.get_command(command_line())


def test_the_pages_show_commands() -> None:
    assert len({line.words for line in LINES}) > 40
    assert {line.place.partition(":")[0] for line in LINES} >= {"README.md", "docs/tutorial.md", "--help"}


@pytest.mark.parametrize("line", [line for line in LINES if line.words], ids=lambda line: line.place)
def test_it_has_the_arguments_and_options_that_are_shown(line: Shown) -> None:
    command, words = HILBENCH, list(line.words)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        assert words[0] in command.commands, f"{line.place}: no command {words[0]}"
        command = command.commands[words.pop(0)]
    if words[:1] != ["--help"]:
        command.make_context(line.text, words)  # raises for an option that is not there


@pytest.mark.parametrize("line", [line for line in LINES if not line.words], ids=lambda line: line.place)
def test_what_is_not_run_is_there(line: Shown) -> None:
    if target := re.match(r"make ([\w-]+)", line.text):
        assert re.search(rf"^([\w-]+ )*{target[1]}( [\w-]+)*:", (ROOT / "Makefile").read_text(), re.MULTILINE)
    if tool := re.search(r"tools/\S+", line.text):
        assert (ROOT / tool[0]).is_file()
    assert line.reason


@pytest.mark.parametrize("pattern", NOT_RUN)
def test_no_reason_is_given_for_nothing(pattern: str) -> None:
    assert any(re.match(pattern, line.text) for line in LINES if not line.words)
