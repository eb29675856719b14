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


@dataclass(frozen=True)
class RunFolder:
    """``runs/<name>-<time>/`` and the paths in it."""

    path: Path

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
    def config(self) -> Path:
        """The resolved bench config."""
        return self.path / "config.yaml"

    @property
    def trace(self) -> Path:
        """Every frame, candump format."""
        return self.path / "trace.log"

    @property
    def journal(self) -> Path:
        """What the bench did and no frame says, a line each."""
        return self.path / "journal.log"

    @property
    def nodes(self) -> Path:
        """What the drives said of themselves before they were configured, and what was written, JSON."""
        return self.path / "nodes.json"

    @property
    def recording(self) -> Path:
        """Every cycle's samples, MDF4."""
        return self.path / "recording.mf4"

    @property
    def unfinished_recording(self) -> Path:
        """The recording of a run that goes on, or was killed: whole but for the last rows, MDF4."""
        return self.path / "recording.part.mf4"

    def row_file(self, number: int) -> Path:
        """Rows that are in no recording yet; numbered from 1."""
        return self.path / f"recording.rows{number}"

    def waiting_rows(self) -> list[Path]:
        """Those that are there."""
        return sorted(self.path.glob("recording.rows*"))

    @property
    def result(self) -> Path:
        """The verdict, JSON."""
        return self.path / "result.json"

    @property
    def junit(self) -> Path:
        """The verdict, JUnit XML, as CI servers show it."""
        return self.path / "result.xml"

    @property
    def report(self) -> Path:
        """The report, one self-contained HTML file."""
        return self.path / "report.html"

    @property
    def diagnosis(self) -> Path:
        """What a diagnosis of the recording has found, JSON; only where there was one."""
        return self.path / "diagnosis.json"

    @property
    def commissioning(self) -> Path:
        """What a commissioning of the stand has measured, JSON; only of such a run."""
        return self.path / "commissioning.json"

    @property
    def labels(self) -> Path:
        """Tags and notes, JSON; only where somebody gave some."""
        return self.path / "labels.json"

    @property
    def traceback(self) -> Path:
        """The traceback of what nobody foresaw; most runs have none."""
        return self.path / TRACEBACK_FILE

    def files(self) -> dict[str, Path]:
        """The files that are there, by what they are."""
        known = {
            "config": self.config,
            "trace": self.trace,
            "journal": self.journal,
            "nodes": self.nodes,
            "recording": self.recording,
            "result": self.result,
            "junit": self.junit,
            "report": self.report,
            "diagnosis": self.diagnosis,
            "commissioning": self.commissioning,
            "labels": self.labels,
            "traceback": self.traceback,
        }
        return {name: path for name, path in known.items() if path.exists()}
