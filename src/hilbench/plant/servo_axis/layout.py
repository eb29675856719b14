"""A shaft in the vectors of the line's kernel: one axis without a span, with its motor and perhaps a load motor.

Positions are rad, forces N·m and masses kg·m², all at the motor shaft (`hilbench.plant.web_line.layout`): the roller's
radius is 1, the tension behind the line is the torque from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final

import numpy as np

from hilbench.plant.interface import Quantity
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.servo_axis.effects import KIND, find
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line import layout as line
from hilbench.plant.web_line.layout import Layout, Vector

#: Rows of the axis, its motor and its load motor.
AXIS: Final = line.W_SIZE
MOTOR: Final = AXIS + line.A_SIZE
LOAD_MOTOR: Final = MOTOR + line.M_SIZE

# Parameters.
P_SAMPLE_TIME_S: Final = line.W_SAMPLE_TIME_S
P_INERTIA: Final = AXIS + line.A_ROLLER_MASS_KG  #: kg·m², of all that turns
P_COULOMB: Final = AXIS + line.A_COULOMB_N  #: N·m
P_VISCOUS: Final = AXIS + line.A_VISCOUS  #: N·m·s/rad
P_UNBALANCE: Final = AXIS + line.A_UNBALANCE_NM
P_UNBALANCE_PHASE: Final = AXIS + line.A_UNBALANCE_PHASE
#: All columns of effects.
P_EFFECTS: Final = np.r_[AXIS + line.A_FIXED : MOTOR, MOTOR + line.M_FIXED : LOAD_MOTOR]

# State.
S_X: Final = line.S_Y  #: of the motor, rad
S_V: Final = S_X + 1
S_X_BEHIND: Final = S_X + 2  #: of the load behind a twisting shaft, else of the motor
S_V_BEHIND: Final = S_X + 3
S_DIRECTION: Final = S_X + 4 + line.SA_DIRECTION
S_MOTORS: Final = S_X + 4 + line.SA_SIZE

# Inputs.
U_TORQUE_NM: Final = line.U_F_NEXT_N  #: external, forward
U_SETPOINT: Final = line.U_MOTORS + line.UM_SETPOINT
U_LOAD_SETPOINT: Final = U_SETPOINT + line.UM_SIZE

#: Public parameters, and their columns in the kernel's parameters.
PARAMETERS: Final[Mapping[str, tuple[Quantity, int]]] = {
    quantity.name: (quantity, column)
    for quantity, column in (
        (Quantity("inertia_kg_m2", "kg·m²", "inertia of all that turns"), P_INERTIA),
        (Quantity("coulomb_friction_Nm", "N·m", "dry friction"), P_COULOMB),
        (Quantity("viscous_friction_Nm_s_per_rad", "N·m·s/rad", "friction per speed"), P_VISCOUS),
        (Quantity("unbalance_Nm", "N·m", "amplitude of the torque of what is unbalanced"), P_UNBALANCE),
        (Quantity("unbalance_phase_rad", "rad", "its phase at position zero"), P_UNBALANCE_PHASE),
    )
}


@cache
def place(effect_id: str, parameter: int = 0, slot: int = 0) -> int:
    """Column of an effect's parameter (by its number in the row, from 0). Raises KeyError."""
    row = AXIS if line.row_of(find(effect_id)) == "axis" else MOTOR
    return row + line.place(effect_id, parameter, slot)


def new_state(parameters: Vector, x_rad: float = 0.0, v_rad_s: float = 0.0) -> Vector:
    """State in this motion of all that turns, drives off."""
    state = line.new_state(parameters)
    state[S_X : S_V_BEHIND + 1] = x_rad, v_rad_s, x_rad, v_rad_s
    return state


def pack(model: ServoAxisParameters, load_motor: LoadMotorParameters | None = None, substeps: int = 1) -> Vector:
    """Parameter vector of an axis: `substeps` integration steps per drive sample time.

    load_motor: a second motor on the shaft. Its rotor's inertia adds to that of the model.
    """
    drives, shaft = model.drives, model.shaft
    layout = Layout(1, 1 if load_motor is None else 2, 0)
    parameters = np.zeros(layout.parameter_size)
    parameters[[line.W_AXES, line.W_MOTORS, line.W_SUBSTEPS]] = layout.axes, layout.motors, substeps
    parameters[line.W_SAMPLE_TIME_S] = drives.sample_time_s if drives else 0.001
    line.clear_effects(parameters, KIND)
    row, motors = layout.axis_rows(parameters)[0], layout.motor_rows(parameters)
    row[[line.A_AXIS, line.A_RADIUS_M, line.A_WEB_LOAD]] = 1.0
    row[line.A_M_PER_TURNED_RAD] = shaft.gear_ratio
    row[line.A_ROLLER_MASS_KG] = model.inertia_kg_m2 + (load_motor.inertia_kg_m2 if load_motor else 0.0)
    row[line.A_COULOMB_N], row[line.A_VISCOUS] = shaft.coulomb_friction_Nm, shaft.viscous_friction_Nm_s_per_rad
    row[line.A_UNBALANCE_NM], row[line.A_UNBALANCE_PHASE] = shaft.unbalance_Nm, shaft.unbalance_phase_rad
    motors[0, line.M_RAD_PER_M] = 1.0
    line.write_drive(motors[0], drives, 1)
    if load_motor is not None:
        line.write_load_motor(motors[1], load_motor, 1, 1.0)
    line.write_entries(parameters, model.effects)
    return parameters
