"""The verdict on a run in one word: of a result in memory, and of the file of one."""

from __future__ import annotations

from typing import Final, Literal

#: Completed: to its end, without a criterion that says anything of it.
RunVerdict = Literal["passed", "failed", "completed", "fault", "interrupted"]
#: Source of the fault of a run that its operator has ended.
BY_OPERATOR: Final = "operator"


def verdict_of(first_fault: str | None, *, judged: bool, passed: bool | None) -> RunVerdict:
    """Verdict by the source of the first fault, if any; also of an older file, whose `passed` is true where nothing was
    judged."""
    if first_fault is not None:
        return "interrupted" if first_fault == BY_OPERATOR else "fault"
    if not judged:
        return "completed"
    return "passed" if passed else "failed"
