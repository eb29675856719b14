"""A servo axis, and variants of it, for its tests."""

from __future__ import annotations

from typing import Any

from hilbench.plant.servo_axis.effects import find
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

DRIVES: dict[str, Any] = {
    "velocity_kp_Nm_s_per_rad": 1.5,
    "velocity_ki_Nm_per_rad": 30.0,
    "torque_limit_Nm": 9.0,
    "current_loop_time_constant_s": 0.001,
    "sample_time_s": 0.001,
}
SHAFT: dict[str, Any] = {
    "inertia_kg_m2": 0.047,
    "coulomb_friction_Nm": 0.2,
    "viscous_friction_Nm_s_per_rad": 0.004,
}


def effect(effect_id: str, *values: float) -> dict[str, Any]:
    """An entry of `effects`, its parameters in the order of the row."""
    names = (parameter.name for parameter in find(effect_id).parameters)
    return {"effect": effect_id, "axis": 1, "parameters": dict(zip(names, values, strict=False))}


def axis(*effects: dict[str, Any], drives: dict[str, Any] | None = None, **shaft: float) -> ServoAxisParameters:
    """0.048 kg·m², with dry and viscous friction; changed values of the shaft or the drives."""
    return ServoAxisParameters.model_validate(
        {
            "kind": "servo_axis",
            "shaft": {**SHAFT, **shaft},
            "motor": {"inertia_kg_m2": 0.001},
            "drives": {**DRIVES, **(drives or {})},
            "effects": list(effects),
        }
    )
