"""What a person reads who asks a machine for a name that it does not have."""

from __future__ import annotations

import pytest

from hilbench.plant.interface import Quantity, checked_name

KNOWN = (Quantity("youngs_modulus_Pa", "Pa", "E"), Quantity("inertia1_kg_m2", "kg·m²", "of the roller"))


def test_unknown_name_is_refused_with_the_names_there_are() -> None:
    assert checked_name("parameter", "youngs_modulus_Pa", KNOWN) == "youngs_modulus_Pa"
    expected = "unknown parameter 'youngs_modulus', expected one of youngs_modulus_Pa, inertia1_kg_m2, did you mean"
    with pytest.raises(ValueError, match=expected):
        checked_name("parameter", "youngs_modulus", KNOWN)
    with pytest.raises(ValueError, match="unknown input 'x', expected none"):
        checked_name("input", "x", ())
