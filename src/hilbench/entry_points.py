"""Objects that hilbench and other packages bring by entry points."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

from hilbench.errors import UnusableInputError


def loaded(entry: EntryPoint) -> Any:
    """Object of an entry point. Raises UnusableInputError, whatever its package raises when it is imported."""
    try:
        return entry.load()
    except Exception as error:  # code of others
        package = entry.dist.name if entry.dist else "a package"
        problem = f"{entry.value} of {package} can't be loaded ({type(error).__name__}: {error})"
        expected = "expected a package that is whole: pip install it again"
        raise UnusableInputError(f"{entry.group} {entry.name}", f"{problem}, {expected}") from error
