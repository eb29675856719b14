"""The resolved config as a bench hands it to the processes that it starts: a file, every default spelled out."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import get_args

from hilbench import strict_yaml
from hilbench.topology.blocks import Pace
from hilbench.topology.config import BenchConfig

#: That of the bench whose process this will be, in a copy of a process that has it.
_known: list[BenchConfig] = []


def remember(config: BenchConfig) -> None:
    """Keep the config of the bench for a forked process. To read it from the file that the bench writes takes longer
    than all else that a process does before it is there."""
    _known[:] = [config]


def write_resolved(config: BenchConfig, path: Path) -> None:
    """Write the config for `read_resolved`; a file that is there already is that of this bench."""
    if not path.exists():
        text = strict_yaml.text_of(config.model_dump(mode="json", exclude_none=True))
        path.write_text(text, encoding="utf-8")


def read_resolved(path: Path) -> BenchConfig:
    """Read the bench of a resolved config, without the experiment in the same file of a run folder.

    Raises UnusableInputError with file, line and what was expected.
    """
    document = strict_yaml.load(path)
    for key in set(document.data) - set(BenchConfig.model_fields):
        document = document.without(key)
    return strict_yaml.validate(document, BenchConfig)


def config_of_process(program: str) -> BenchConfig:
    """The config by the command line of a process of the bench: ``CONFIG [--pace PACE]``.

    Started by anybody else than a bench they go by the clock: only a bench knows that it waits for them. Raises
    UnusableInputError.
    """
    parser = ArgumentParser(prog=f"python -m {program}")
    parser.add_argument("config", type=Path, help="resolved bench config")
    parser.add_argument("--pace", choices=get_args(Pace), default="realtime", help="by the clock, or by SYNC")
    given = parser.parse_args()
    config = _known[0] if _known else read_resolved(given.config)
    return config.model_copy(update={"pace": given.pace})
