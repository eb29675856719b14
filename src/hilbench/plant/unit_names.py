"""The SI units of quantities by how their names end."""

from __future__ import annotations

from typing import Final

#: A suffix that another one ends with stands before it.
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
    """The SI unit that a name of ours ends with; "1" for one without."""
    return next((unit for suffix, unit in _SUFFIXES if name.endswith(suffix)), "1")
