"""Diagnosis of rotary axes from 50 W to flywheels, simulated with other equations: cases of tools/diagnose_axes.py."""

from __future__ import annotations

import diagnose_axes
import pytest
from tests.tiers import slow


@pytest.mark.parametrize("seed", [1, 18, *slow(23, 28)])
def test_what_is_hidden_is_named_and_nothing_else(seed: int) -> None:
    """1, 18: an unbalance, which a ripple once a turn is tied with; 23, 28: one over few turns."""
    case = diagnose_axes.run(diagnose_axes.drawn(seed))
    assert diagnose_axes.right(case), (case.hidden, case.verdict, case.found, case.tied)
