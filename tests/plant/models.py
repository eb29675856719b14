"""The demonstrator's model, and variants of it, for the tests of the web."""

from __future__ import annotations

from typing import Any

from hilbench.plant.web_line.parameters import ModelParameters

DEMONSTRATOR: dict[str, Any] = {
    "web": {"youngs_modulus_Pa": 8.7e9, "width_m": 0.5, "thickness_m": 65e-6, "span_length_m": 1.0},
    "rollers": {"radius_m": 0.2, "inertia_kg_m2": 1.167, "gear_ratio": 5.0},
    "motors": {"inertia_kg_m2": 0.001},
    "drives": {
        "velocity_kp_Nm_s_per_rad": 1.5,
        "velocity_ki_Nm_per_rad": 30.0,
        "torque_limit_Nm": 9.0,
        "current_loop_time_constant_s": 0.001,
        "sample_time_s": 0.001,
    },
    "boundary": {"upstream_tension_N": 80.0, "downstream_tension_N": 70.0},
}


def effect(effect_id: str, axis: int | None = None, **parameters: float) -> dict[str, Any]:
    """An entry of a model's `effects`."""
    return {"effect": effect_id, "axis": axis, "parameters": parameters}


def model(*effects: dict[str, Any], **changes: Any) -> ModelParameters:
    """The demonstrator with effects and changed top-level keys."""
    return ModelParameters.model_validate({**DEMONSTRATOR, **changes, "effects": list(effects)})


def line_of(axes: int, *effects: dict[str, Any]) -> ModelParameters:
    """A line of rollers that differ from each other."""
    web = {**DEMONSTRATOR["web"], "span_length_m": [1.0 + 0.2 * k for k in range(axes - 1)]}
    rollers = {
        "radius_m": [0.2 - 0.01 * k for k in range(axes)],
        "inertia_kg_m2": [1.167 + 0.1 * k for k in range(axes)],
        "gear_ratio": 5.0,
    }
    return model(*effects, web=web, rollers=rollers)


def lone_axis(*effects: dict[str, Any], current_s: float = 0.0) -> ModelParameters:
    """One roller, 2 kg of it and 1 kg of motor; a metre of web is a radian of motor: torque equals force."""
    drives = {**DEMONSTRATOR["drives"], "current_loop_time_constant_s": current_s, "torque_limit_Nm": 1000.0}
    return ModelParameters.model_validate(
        {
            "rollers": {"radius_m": 1.0, "inertia_kg_m2": 2.0, "gear_ratio": 1.0},
            "motors": {"inertia_kg_m2": 1.0},
            "drives": drives,
            "effects": list(effects),
        }
    )
