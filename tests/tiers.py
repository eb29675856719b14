"""Members of a parametrization that only `make test-slow` runs: the others show the same, if more roughly."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*members: Any) -> list[Any]:
    """Mark them; a tuple is the values of several arguments."""
    return [
        pytest.param(*(member if isinstance(member, tuple) else (member,)), marks=pytest.mark.slow)
        for member in members
    ]
