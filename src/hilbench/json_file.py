"""Files of a run folder that are one JSON object, written and read by the model that describes it."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Final, Self

from pydantic import ValidationError

from hilbench.block import Strict
from hilbench.errors import UnusableInputError
from hilbench.files import content, usable, write_whole

#: Of one file, at most.
_MOST_BYTES: Final = 64_000_000


class JsonFile(Strict):
    """Base of the model of such a file."""

    #: What one expects of the file, in messages, and by how much its lines are indented.
    described: ClassVar[str]
    indent: ClassVar[int] = 2

    def write(self, path: Path) -> None:
        """Write as JSON; the file appears complete or not at all. Raises UnusableInputError if it cannot be."""
        write_whole(path, self.model_dump_json(indent=self.indent) + "\n")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read and check. Raises UnusableInputError: file, key, value found."""
        with usable(path, "read", cls.described):
            found = content(path, _MOST_BYTES, kept=True)
        try:
            return cls.model_validate_json(found)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(map(str, first["loc"])) or "the file"
            raise UnusableInputError(
                path, f"{key}: {' '.join(first['msg'].split())}, expected {cls.described}"
            ) from error
