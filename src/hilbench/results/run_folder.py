"""The folder a run leaves behind: where each of its files is, and that no run ever overwrites another."""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Self

from hilbench.crash_report import TRACEBACK_FILE
from hilbench.errors import UnusableInputError

_UNSAFE = re.compile(r"[^A-Za-z0-9._+-]+")
_LONGEST_NAME = 100


class _File:
    """A file of a run folder, by its name in it."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, folder: RunFolder, owner: type[RunFolder]) -> Path:
        return folder.path / self.name


@dataclass(frozen=True)
class RunFolder:
    """``runs/<name>-<time>/`` and the paths in it."""

    path: Path

    config = _File("config.yaml")  #: the resolved bench config
    trace = _File("trace.log")  #: every frame, candump format
    journal = _File("journal.log")  #: what the bench did and no frame says, a line each
    nodes = _File("nodes.json")  #: what drives said before they were configured, and what was written, JSON
    recording = _File("recording.mf4")  #: every cycle's samples, MDF4
    result = _File("result.json")  #: the verdict, JSON
    junit = _File("result.xml")  #: the verdict, JUnit XML, as CI servers show it
    report = _File("report.html")  #: the report, one self-contained HTML file
    diagnosis = _File("diagnosis.json")  #: what a diagnosis of the recording has found, JSON; only where there was one
    commissioning = _File("commissioning.json")  #: measured by a commissioning of the stand, JSON; only of such a run
    labels = _File("labels.json")  #: tags and notes, JSON; only where somebody gave some
    traceback = _File(TRACEBACK_FILE)  #: the traceback of what nobody foresaw; most runs have none

    @classmethod
    def create(cls, base: Path, name: str, time: datetime | None = None) -> Self:
        """Make a new folder under `base` (made too if need be), named after the run and its local time.

        Characters that are awkward in file names become ``-``; a folder that exists already is left alone and
        the new one gets ``-2``, ``-3``, … Permissions follow the process' umask.
        Raises UnusableInputError if the folder cannot be made.
        """
        moment = time if time is not None else datetime.now()
        safe = _UNSAFE.sub("-", name).strip("-.")[:_LONGEST_NAME] or "run"
        stem = f"{safe}-{moment:%Y%m%d-%H%M%S}"
        try:
            base.mkdir(parents=True, exist_ok=True)
            for number in itertools.count(1):
                path = base / (stem if number == 1 else f"{stem}-{number}")
                try:
                    path.mkdir()
                except FileExistsError:
                    continue
                return cls(path)
        except OSError as error:
            raise UnusableInputError(
                base, f"no run folder can be made here ({error.strerror}), expected a writable folder"
            ) from error
        raise AssertionError("unreachable: count has no end")

    @classmethod
    def open(cls, path: Path) -> Self:
        """An existing run folder. Raises UnusableInputError if it is none."""
        folder = cls(path)
        if not folder.config.is_file():
            raise UnusableInputError(path, f"no {folder.config.name} in it, expected the folder of a run")
        return folder

    @property
    def name(self) -> str:
        """The folder's name: the run's, and its time."""
        return self.path.resolve().name

    @property
    def unfinished_recording(self) -> Path:
        """The recording of a run that goes on, or was killed: whole but for the last rows, MDF4."""
        return self.path / "recording.part.mf4"

    def row_file(self, number: int) -> Path:
        """Rows that are in no recording yet; numbered from 1."""
        return self.path / f"recording.rows{number}"

    def waiting_rows(self) -> list[Path]:
        """Row files that wait to be put into the recording."""
        return sorted(self.path.glob("recording.rows*"))

    def files(self) -> dict[str, Path]:
        """The files that are there, by what they are."""
        files = {name: self.path / file.name for name, file in vars(RunFolder).items() if isinstance(file, _File)}
        return {name: path for name, path in files.items() if path.exists()}
