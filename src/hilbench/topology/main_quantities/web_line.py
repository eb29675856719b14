"""A web line: its speed, the tension, the elasticity of the web."""

from __future__ import annotations

from typing import Final

from hilbench.topology.main_quantities.quantity import MainQuantity
from hilbench.topology.quantities import LINE_SPEED, TENSION_SET_POINT, YOUNGS_MODULUS

SPEED: Final = MainQuantity(LINE_SPEED, "line speed", "line speed", "m/s", "v2_cmd_m_s", "v")
SET_POINT: Final = MainQuantity(
    TENSION_SET_POINT, "tension set-point", "set-point", "N", "F_ref_N", "t", "F_sim_N", "tension"
)
MODULUS: Final = MainQuantity(
    YOUNGS_MODULUS,
    "E of the imitated web",
    "E",
    "Pa",
    "E_true_Pa",
    "m",
    "E_sim_Pa",
    shown_unit="N/mm²",
    si_per_shown=1e6,
    imitated=True,
)
QUANTITIES: Final = (MODULUS, SET_POINT, SPEED)
