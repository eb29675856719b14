"""What somebody may have meant who misspelt a name."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

#: Least likeness (0 to 1, as difflib has it) of a name that is worth a question.
_ALIKE = 0.6


def closest(name: str, known: Iterable[str], count: int = 1) -> list[str]:
    """The known names that are most like `name`, the best first; upper and lower case are alike."""
    by_lower: dict[str, str] = {}
    for candidate in known:
        by_lower.setdefault(candidate.lower(), candidate)
    return [by_lower[found] for found in get_close_matches(name.lower(), by_lower, count, _ALIKE)]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """To be put behind the text of an error: ``, did you mean 'x'?``; nothing where no known name is like it."""
    found = closest(name, known)
    return f", did you mean '{found[0]}'?" if found else ""
