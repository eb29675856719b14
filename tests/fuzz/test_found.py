"""Inputs that once made a reader or a receiver fail (found by `tools/fuzz.py`), and the good ones it begins with."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.fuzz.targets import TARGETS

FOUND = Path(__file__).parent / "found"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", TARGETS)
def test_what_was_found_is_survived(name: str) -> None:
    target = TARGETS[name]
    for data in [*target.seeds(), *(path.read_bytes() for path in sorted(FOUND.glob(f"{name}-*")))]:
        target.run(data)
