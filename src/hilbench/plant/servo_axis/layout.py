"""Layout of the flat arrays of the servo axis's kernel. Offsets of effects follow from their rows.

Three vectors of float64 describe a shaft with M motors (the drive's, and a load motor where there is one), SI:

- parameters: counts and the shaft, effects, M rows of drive loops (`drive_loops`);
- state: sample counter, position, speed, direction of the dry friction, mean torque of the drive, twist of a shaft with
  a resonance, past torques of the drive, M rows of drive states;
- inputs: external torque, M rows of drive inputs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cache
from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilbench.plant import drive_loops as loops
from hilbench.plant.effects import effects_of
from hilbench.plant.interface import Quantity
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.parameters import DriveParameters, LoadMotorParameters, per_item
from hilbench.plant.servo_axis.effects import KIND, ShaftEffect, effect_problem, find
from hilbench.plant.servo_axis.parameters import ServoAxisParameters

Vector = NDArray[np.float64]

# Parameters.
P_MOTORS: Final = 0
P_SAMPLE_TIME_S: Final = 1
P_SUBSTEPS: Final = 2  #: integration steps per sample time
P_INERTIA: Final = 3  #: kg·m², of all that turns
P_COULOMB: Final = 4  #: N·m
P_VISCOUS: Final = 5  #: N·m·s/rad
P_UNBALANCE: Final = 6  #: N·m
P_UNBALANCE_PHASE: Final = 7  #: rad
P_GEAR_RATIO: Final = 8
P_EFFECTS: Final = 9  #: the first of the effects' parameters, up to P_LOOPS

# State.
S_COUNT: Final = 0
S_X: Final = 1
S_V: Final = 2
S_DIRECTION: Final = 3  #: of the dry friction: -1, 1, or 0 (sticks)
S_MEAN: Final = 4  #: N·m, mean torque of the drive in the last step
S_TWIST: Final = 5  #: rad, of the load behind a twisting shaft, less the motor's
S_TWIST_RATE: Final = 6  #: rad/s
S_PAST: Final = 7
RING: Final = 128  #: past torques of the drive, one per sample time
S_MOTORS: Final = S_PAST + RING

# Inputs.
U_TORQUE_NM: Final = 0  #: external, forward
U_MOTORS: Final = 1

# Columns of the observed values: position, speed, mean torque of the drive in the last step, then each motor's torque.
O_X: Final = 0
O_V: Final = 1
O_MEAN: Final = 2
O_TORQUE: Final = 3

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


def _allocate() -> tuple[dict[str, int], int]:
    first, size = {}, P_EFFECTS
    for effect in effects_of(KIND):
        first[effect.id] = size
        size += effect.slots * len(effect.parameters)
    return first, size


_FIRST, P_LOOPS = _allocate()


@cache
def place(effect_id: str, parameter: int = 0, slot: int = 0) -> int:
    """Column of an effect's parameter (by its number in the row, from 0). Raises KeyError."""
    return _FIRST[effect_id] + slot * len(find(effect_id).parameters) + parameter


def motor_count(parameters: Vector) -> int:
    """Number of motors M of a parameter vector."""
    return int(parameters[P_MOTORS])


def output_size(parameters: Vector) -> int:
    """Number of columns of the observed values."""
    return O_TORQUE + motor_count(parameters)


def new_state(parameters: Vector) -> Vector:
    """State at rest at position zero, drives off."""
    return np.zeros(S_MOTORS + motor_count(parameters) * loops.STATE_SIZE)


def new_inputs(parameters: Vector) -> Vector:
    """Inputs with every motor off, without external torque."""
    inputs = np.zeros(U_MOTORS + motor_count(parameters) * loops.IN_SIZE)
    rows = motor_inputs(inputs)
    rows[:, loops.IN_MODE] = MotorMode.OFF
    rows[:, loops.IN_SLOPE] = inf
    rows[:, loops.IN_LIMIT_NM] = inf
    return inputs


def motor_inputs(inputs: Vector) -> Vector:
    """View of the motors' inputs (M, IN_SIZE)."""
    return inputs[U_MOTORS:].reshape(-1, loops.IN_SIZE)


def motor_states(state: Vector) -> Vector:
    """View of the motors' states (M, STATE_SIZE)."""
    return state[S_MOTORS:].reshape(-1, loops.STATE_SIZE)


def write_effect(parameters: Vector, effect_id: str, slot: int, values: Iterable[float]) -> None:
    """Write an effect's (checked, complete) parameters, in the order of its row."""
    first = place(effect_id, 0, slot)
    for number, value in enumerate(values):
        parameters[first + number] = value


def check_effect(effect_id: str, axis: int | None, slot: int, values: dict[str, float]) -> None:
    """Raise ValueError for an effect, axis, slot or value that a servo axis cannot have."""
    problem = effect_problem(effect_id, axis)
    if problem is None:
        effect = find(effect_id)
        problem = effect.problem(values)
        if problem is None and not 0 <= slot < effect.slots:
            problem = f"effect '{effect_id}' in slot {slot}, expected 0 to {effect.slots - 1}"
    if problem:
        raise ValueError(problem)


def write_entries(parameters: Vector, entries: Iterable[ShaftEffect]) -> None:
    """Set every effect neutral, then those of a config; effects with several slots fill them in order."""
    for effect in effects_of(KIND):
        for slot in range(effect.slots):
            write_effect(parameters, effect.id, slot, effect.filled({}).values())
    used: dict[str, int] = {}
    for entry in entries:
        slot = used.get(entry.effect, 0)
        used[entry.effect] = slot + 1
        check_effect(entry.effect, entry.axis, slot, entry.parameters)
        write_effect(parameters, entry.effect, slot, find(entry.effect).filled(entry.parameters).values())
    check_delay(parameters)


def check_delay(parameters: Vector) -> None:
    """Raise ValueError for a torque delay longer than torques are kept."""
    longest = (RING - 2) * parameters.item(P_SAMPLE_TIME_S)
    if parameters[place("torque_delay")] > longest:
        raise ValueError(
            f"effect 'torque_delay' of {parameters[place('torque_delay')]:g} s, expected at most {longest:g} s"
        )


def _new(motors: int, sample_time_s: float, substeps: int) -> Vector:
    parameters = np.zeros(P_LOOPS + motors * loops.LOOPS_SIZE)
    parameters[[P_MOTORS, P_SAMPLE_TIME_S, P_SUBSTEPS]] = motors, sample_time_s, substeps
    return parameters


def _write_drive(row: Vector, drives: DriveParameters | None) -> None:
    """Write the loops of the drive; without drives the motor has none, and no limit."""
    row[loops.KP] = per_item(drives.velocity_kp_Nm_s_per_rad, 1) if drives else 0.0
    row[loops.KI] = per_item(drives.velocity_ki_Nm_per_rad, 1) if drives else 0.0
    row[loops.POSITION_KP] = per_item(drives.position_kp_per_s, 1) if drives else 0.0
    row[loops.LIMIT_NM] = per_item(drives.torque_limit_Nm, 1) if drives else inf
    row[loops.CURRENT_S] = per_item(drives.current_loop_time_constant_s, 1) if drives else 0.0


def _write_load_motor(row: Vector, load: LoadMotorParameters) -> None:
    row[loops.KP] = load.velocity_kp_Nm_s_per_rad
    row[loops.KI] = load.velocity_ki_Nm_per_rad
    row[loops.POSITION_KP] = load.position_kp_per_s
    row[loops.LIMIT_NM] = load.torque_limit_Nm
    row[loops.CURRENT_S] = load.current_loop_time_constant_s


def pack(model: ServoAxisParameters, load_motor: LoadMotorParameters | None = None, substeps: int = 1) -> Vector:
    """Parameter vector of an axis: `substeps` integration steps per drive sample time.

    load_motor: a second motor on the shaft. Its rotor's inertia adds to that of the model.
    """
    drives, shaft = model.drives, model.shaft
    parameters = _new(1 if load_motor is None else 2, drives.sample_time_s if drives else 0.001, substeps)
    parameters[P_INERTIA] = model.inertia_kg_m2 + (load_motor.inertia_kg_m2 if load_motor else 0.0)
    parameters[P_COULOMB] = shaft.coulomb_friction_Nm
    parameters[P_VISCOUS] = shaft.viscous_friction_Nm_s_per_rad
    parameters[P_UNBALANCE] = shaft.unbalance_Nm
    parameters[P_UNBALANCE_PHASE] = shaft.unbalance_phase_rad
    parameters[P_GEAR_RATIO] = shaft.gear_ratio
    rows = parameters[P_LOOPS:].reshape(-1, loops.LOOPS_SIZE)
    _write_drive(rows[0], drives)
    if load_motor is not None:
        _write_load_motor(rows[1], load_motor)
    write_entries(parameters, model.effects)
    return parameters
