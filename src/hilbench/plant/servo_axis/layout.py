"""A shaft in the vectors of the line's kernel: one axis without a span, with its motor and perhaps a load motor.

Positions are rad, forces N·m and masses kg·m², all at the motor shaft (`hilbench.plant.web_line.layout`): the roller's
radius is 1, the tension behind the line is the torque from outside.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Final

import numpy as np

from hilbench.compiled import Vector
from hilbench.plant.interface import Quantity
from hilbench.plant.parameters import LoadMotorParameters
from hilbench.plant.servo_axis.effects import KIND, find
from hilbench.plant.servo_axis.parameters import ServoAxisParameters
from hilbench.plant.web_line import layout as line

#: Offsets of the rows of the axis and its motor.
AXIS: Final = line.W_SIZE
MOTOR: Final = AXIS + line.A_SIZE

# Parameters.
P_SAMPLE_TIME_S: Final = line.W_SAMPLE_TIME_S
P_INERTIA: Final = AXIS + line.column(line.AXIS, "roller_mass_kg")  #: kg·m², of all that turns
P_COULOMB: Final = AXIS + line.column(line.AXIS, "coulomb_N")  #: N·m
P_VISCOUS: Final = AXIS + line.column(line.AXIS, "viscous_N_s_per_m")  #: N·m·s/rad
P_UNBALANCE: Final = AXIS + line.column(line.AXIS, "unbalance_Nm")
#: All columns of effects.
P_EFFECTS: Final = np.r_[
    AXIS + line.column(line.AXIS, "m_per_turned_rad") + 1 : MOTOR,
    MOTOR + line.column(line.MOTOR, "axis") + 1 : MOTOR + line.M_SIZE,
]

# State.
S_X: Final = line.S_Y  #: of the motor, rad
S_V: Final = S_X + 1
S_X_BEHIND: Final = S_X + 2  #: of the load behind a twisting shaft, else of the motor
S_V_BEHIND: Final = S_X + 3
S_DIRECTION: Final = S_X + 4

# Inputs.
U_TORQUE_NM: Final = 1  #: external, forward: `F_next_N`
U_SETPOINT: Final = line.U_MOTORS + line.UM_SETPOINT

#: Public parameters, and their columns in the kernel's parameters.
PARAMETERS: Final[Mapping[str, tuple[Quantity, int]]] = {
    quantity.name: (quantity, column)
    for quantity, column in (
        (Quantity("inertia_kg_m2", "kg·m²", "inertia of all that turns"), P_INERTIA),
        (Quantity("coulomb_friction_Nm", "N·m", "dry friction"), P_COULOMB),
        (Quantity("viscous_friction_Nm_s_per_rad", "N·m·s/rad", "friction per speed"), P_VISCOUS),
        (Quantity("unbalance_Nm", "N·m", "amplitude of the torque of what is unbalanced"), P_UNBALANCE),
        (Quantity("unbalance_phase_rad", "rad", "its phase at position zero"), P_UNBALANCE + 1),
    )
}


@cache
def place(effect_id: str, parameter: int = 0, slot: int = 0) -> int:
    """Column of an effect's parameter (by its number in the row, from 0). Raises KeyError."""
    row = AXIS if find(effect_id).id in (line.AXIS.names or ()) else MOTOR
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
    layout = line.Layout(1, 1 if load_motor is None else 2, 0)
    parameters = line.new_parameters(layout, drives.sample_time_s if drives else 0.001, substeps, KIND)
    row, motors = layout.axis_rows(parameters)[0], layout.motor_rows(parameters)
    row.number = row.radius_m = row.web_load = 1.0
    row.m_per_turned_rad = shaft.gear_ratio
    row.roller_mass_kg = model.inertia_kg_m2 + (load_motor.inertia_kg_m2 if load_motor else 0.0)
    row.coulomb_N, row.viscous_N_s_per_m = shaft.coulomb_friction_Nm, shaft.viscous_friction_Nm_s_per_rad
    row.unbalance_Nm, row.unbalance_phase_rad = shaft.unbalance_Nm, shaft.unbalance_phase_rad
    motors[0].rad_per_m = 1.0
    line.write_drive(motors[0], drives, 1)
    if load_motor is not None:
        line.write_load_motor(motors[1], load_motor, 1, 1.0)
    line.write_entries(parameters, model.effects)
    return parameters
