"""What every command says of itself."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

import pytest
import typer
from tests.cli.in_process import hilbench

from hilbench.apps.cli.main import command_line


def commands(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield words
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*words, name))


ALL = list(commands(typer.main.get_command(command_line())))


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_every_command_knows_both_ways_to_ask_for_help(words):
    short, long = hilbench(*words, "-h"), hilbench(*words, "--help")
    assert (short.returncode, long.returncode) == (0, 0)
    assert short.stdout == long.stdout
    assert re.search(rf"Usage: .*hilbench {' '.join(words)}", short.stdout)


def test_it_says_its_version():
    done = hilbench("--version")
    assert (done.returncode, done.stdout.strip()) == (0, f"hilbench {version('hilbench')}")


@pytest.mark.parametrize(("typed", "meant"), [(["rn"], "'run'"), (["run", "--sed", "3"], "--seed")])
def test_a_misspelt_command_or_option_is_asked_about(typed, meant):
    done = hilbench(*typed)
    assert done.returncode == 2
    assert meant in done.stderr
