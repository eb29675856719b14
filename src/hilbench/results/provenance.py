"""Provenance of a run: what was overridden, the commit of its config, host and EDS files."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from hilbench import strict_yaml
from hilbench.bench.lifecycle.participants import Participants
from hilbench.block import Strict
from hilbench.files import usable
from hilbench.topology.config import BenchConfig

_GIT_TIMEOUT_S = 5.0


class Override(Strict):
    """A value of the config that an option gave: ``pace`` is ``realtime`` by ``--pace``."""

    key: str
    value: Any
    option: str


class Commit(Strict):
    """The git commit that is checked out where the config lies; `changed`: files of it differ from the commit, or the
    config itself is not part of it."""

    commit: str
    changed: bool


class EdsFile(Strict):
    """An EDS or DCF file as it was when the run began, and the nodes it was used for."""

    file: str
    sha256: str
    nodes: list[str]


class Provenance(Strict):
    """Provenance of a run. `participants`: who brought the simulated hardware and the twin; `git` is None where the
    config is in no checkout, or not asked for yet."""

    config: str
    host: str
    participants: str
    overridden: list[Override]
    git: Commit | None = None
    eds: list[EdsFile]

    @classmethod
    def of(cls, config: BenchConfig, document: strict_yaml.Document, participants: Participants) -> Self:
        """Provenance of a run that is about to start. Raises UnusableInputError for an EDS file that has gone."""
        return cls(
            config=str(document.path),
            host=platform.node(),
            participants=participants.value,
            overridden=overridden(document),
            eds=list(_eds_files(config)),
        )


def overridden(document: strict_yaml.Document) -> list[Override]:
    """The values that options gave, by their keys."""
    return [
        Override(key=".".join(map(str, location)), value=document.value(location), option=place.split(" ")[0])
        for location, place in document.places.items()
        if place.startswith("--")
    ]


def commit_of(path: Path) -> Commit | None:
    """The commit that is checked out at a file; None outside of a checkout, or without git."""
    commit = _git(path, "rev-parse", "--verify", "HEAD")
    if commit is None:
        return None
    status = _git(path, "status", "--porcelain", "--untracked-files=no")
    tracked = _git(path, "ls-files", "--error-unmatch", "--", path.resolve().name)
    return Commit(commit=commit.strip(), changed=status is None or bool(status.strip()) or tracked is None)


def _git(path: Path, *words: str) -> str | None:
    """Answer of git in the folder of a file. It writes nothing there, and runs nothing that the checkout names."""
    try:
        asked = subprocess.run(
            ["git", "-c", "core.fsmonitor=false", "-C", str(path.resolve().parent), *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            env={**os.environ, "GIT_OPTIONAL_LOCKS": "0"},
            timeout=_GIT_TIMEOUT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):  # there is no git, or it waits for something
        return None
    return asked.stdout if asked.returncode == 0 else None


def _eds_files(config: BenchConfig) -> Iterable[EdsFile]:
    nodes: dict[Path, list[str]] = {}
    for part in config.parts:
        nodes.setdefault(part.node.eds, []).append(part.name)
    for file, names in nodes.items():
        with usable(file, "read", "an EDS file"):
            content = file.read_bytes()
        yield EdsFile(file=str(file), sha256=hashlib.sha256(content).hexdigest(), nodes=names)
