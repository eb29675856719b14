"""SI units of quantities by the suffixes of their names."""

from __future__ import annotations

from typing import Final

#: A suffix precedes another one that it ends with.
_SUFFIXES: Final = (
    ("_Nm_s_per_rad", "N·m·s/rad"),
    ("_kg_m2", "kg·m²"),
    ("_rad_s", "rad/s"),
    ("_m_s", "m/s"),
    ("_rad", "rad"),
    ("_Nm", "N·m"),
    ("_Pa", "Pa"),
    ("_N", "N"),
    ("_m", "m"),
    ("_s", "s"),
)


def unit_of_name(name: str) -> str:
    """SI unit of a name by its suffix; "1" for one without."""
    return next((unit for suffix, unit in _SUFFIXES if name.endswith(suffix)), "1")
