"""The cases of a tool on all cores, each kept in a line of a file once it is finished: an ended tool goes on there."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar


class Case(Protocol):
    """A dataclass whose name says which case it is."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def name(self) -> str:
        """What tells it from others."""


Kind = TypeVar("Kind", bound=Case)


def finish(
    asked: Sequence[Kind], run: Callable[[Kind], Kind], kept: Path | None, jobs: int | None = None
) -> list[Kind]:
    """The cases as `run` finishes them, `jobs` at a time (None: one a core); those that stand in `kept` are taken from
    there, the others are added to it."""
    done = kept_of(asked, kept)
    known = {case.name for case in done}
    with ProcessPoolExecutor(jobs) as pool:
        for finished in as_completed([pool.submit(run, case) for case in asked if case.name not in known]):
            if finished.exception() is not None:  # at once, not after all the others
                pool.shutdown(wait=False, cancel_futures=True)
            case = finished.result()
            done.append(case)
            if kept is not None:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(case)) + "\n")
    return done


def kept_of(asked: Sequence[Kind], kept: Path | None) -> list[Kind]:
    """Finished cases in `kept`, of those asked for."""
    names = {case.name for case in asked}
    return [case for case in _read(kept, type(asked[0])) if case.name in names] if asked else []


def _read(kept: Path | None, kind: type[Kind]) -> list[Kind]:
    if kept is None or not kept.exists():
        return []
    return [kind(**json.loads(line)) for line in kept.read_text(encoding="utf-8").splitlines()]
