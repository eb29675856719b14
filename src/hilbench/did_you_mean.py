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


def expected_one_of(name: str, known: Iterable[str]) -> str:
    """The same with all that are known behind it: ``, did you mean 'x'? Expected one of x, y``; where none is like it
    ``, expected one of x, y``."""
    names = list(known)
    meant = did_you_mean(name, names)
    return f"{meant} Expected one of {', '.join(names)}" if meant else f", expected one of {', '.join(names)}"
