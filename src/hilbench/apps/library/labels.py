"""Labels of a run: tags and notes, in a file of its own in the run folder."""

from __future__ import annotations

import getpass
import re
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import ClassVar, Final, Self

from pydantic import Field

from hilbench.block import Strict
from hilbench.errors import UnusableInputError
from hilbench.json_file import JsonFile
from hilbench.results.run_folder import RunFolder

_TAG: Final = re.compile(r"[\w.+:/-]{1,60}")
_LONGEST_NOTE: Final = 4000


class Note(Strict):
    """A remark: when (ISO 8601, UTC), who, and what."""

    time: str
    by: str
    text: str


class Labels(JsonFile):
    """Tags, in the order of the alphabet, and notes, the oldest first."""

    described: ClassVar[str] = "tags and notes of a run"

    tags: list[str] = Field(default_factory=list)
    notes: list[Note] = Field(default_factory=list)

    @classmethod
    def of(cls, folder: RunFolder) -> Self:
        """Labels of a run; none where there is no such file. Raises UnusableInputError for a file that is none."""
        return cls.read(folder.labels) if folder.labels.exists() else cls()


def tag(folder: RunFolder, add: Iterable[str] = (), remove: Iterable[str] = ()) -> Labels:
    """Give a run tags, and take others away. Raises UnusableInputError for what can be no tag, or can't be written."""
    wanted = [*add]
    for name in wanted:
        if not _TAG.fullmatch(name):
            raise UnusableInputError("tag", f"'{name}', expected one word of letters, digits and . + : / - _")
    labels = Labels.of(folder)
    tags = sorted(({*labels.tags} | {*wanted}) - {*remove})
    return _write(folder, labels.model_copy(update={"tags": tags}))


def note(folder: RunFolder, text: str) -> Labels:
    """Add a note to a run. Raises UnusableInputError for one without words, a very long one, or one that can't be
    written."""
    words = text.strip()
    if not words or len(words) > _LONGEST_NOTE:
        raise UnusableInputError("note", f"of {len(words)} characters, expected 1 to {_LONGEST_NOTE}")
    labels = Labels.of(folder)
    made = Note(time=datetime.now(UTC).isoformat(timespec="seconds"), by=user_name("unknown"), text=words)
    return _write(folder, labels.model_copy(update={"notes": [*labels.notes, made]}))


def _write(folder: RunFolder, labels: Labels) -> Labels:
    labels.write(folder.labels)
    return labels


def user_name(otherwise: str) -> str:
    """Name of the user of this process."""
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # a user id without a name, as in some containers
        return otherwise
