"""Suggestions for a misspelt name."""

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
    """Suffix of an error text: ``, did you mean 'x'?``; empty where no known name is similar."""
    found = closest(name, known)
    return f", did you mean '{found[0]}'?" if found else ""


def expected_one_of(name: str, known: Iterable[str]) -> str:
    """Suffix of an error text with all known names: ``, did you mean 'x'? Expected one of x, y``; where none is similar
    ``, expected one of x, y``."""
    names = list(known)
    meant = did_you_mean(name, names)
    return f"{meant} Expected one of {', '.join(names)}" if meant else f", expected one of {', '.join(names)}"
