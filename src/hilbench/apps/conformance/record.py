"""Record of an examination: steps with what was sent, expected and seen, verdicts, the whole."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeVar

Found = TypeVar("Found")


class Verdict(StrEnum):
    """Verdict of one case."""

    PASSED = "passed"
    FAILED = "failed"
    NOT_APPLICABLE = "not applicable"
    NOT_ALLOWED = "not allowed"


@dataclass(frozen=True)
class Step:
    """One expectation: frames as identifier and data in hexadecimal digits."""

    what: str
    sent: str
    expected: str
    seen: str
    ok: bool


@dataclass(frozen=True)
class Case:
    """One case, and where the standard asks for it."""

    group: str
    number: int
    title: str
    clause: str

    @property
    def label(self) -> str:
        """Number of the case in its group."""
        return f"{self.number}"

    @property
    def name(self) -> str:
        """Group and number: "SDO 5"; "Modes 1, axis 2" of a device with several axes."""
        return f"{self.group} {self.label}"


@dataclass(frozen=True)
class CaseResult(Case):
    """One case that was examined, or why it was not."""

    verdict: Verdict
    reason: str
    steps: Sequence[Step] = ()
    notes: Sequence[str] = ()
    axis: int | None = None  #: of a device with several

    @property
    def label(self) -> str:
        """Number of the case in its group, and the axis of a device with several."""
        return f"{self.number}" if self.axis is None else f"{self.number}, axis {self.axis}"


@dataclass(frozen=True)
class Examination:
    """Examination of one device: all its cases."""

    device: str
    node_id: int
    bus: str
    eds: str
    cases: Sequence[CaseResult] = field(default=())

    @property
    def failed(self) -> list[CaseResult]:
        """Cases that failed."""
        return [case for case in self.cases if case.verdict is Verdict.FAILED]


def counts(cases: Iterable[CaseResult]) -> dict[Verdict, int]:
    """Number of cases with each verdict."""
    found = Counter(case.verdict for case in cases)
    return {verdict: found[verdict] for verdict in Verdict}


def counted(cases: Iterable[CaseResult]) -> str:
    """Number of each verdict, for a person."""
    return ", ".join(f"{count} {verdict}" for verdict, count in counts(cases).items() if count)


def some(found: list[Found], otherwise: str) -> list[Found]:
    """Return what was found. Raises NotApplicableError, with the reason, where that is nothing."""
    if not found:
        raise NotApplicableError(otherwise)
    return found


class CaseEndedError(Exception):
    """A case can't go on: what it is about has not happened. Its steps say what failed."""


class NotApplicableError(Exception):
    """The device lacks, by its EDS file or by its answers, what the case is about."""


class NotAllowedError(Exception):
    """The case would move or store something, without permission."""
