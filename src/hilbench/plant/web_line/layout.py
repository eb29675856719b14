"""Layout of the kernel's flat arrays. Offsets of effects follow from the table of effects.

Three vectors of float64 describe a line of N axes, M motors and K spans:

- parameters: web row, N axis rows, M motor rows, K span rows (the counts come first, so the vector is
  self-describing);
- state: sample counter, the integrated quantities (x, v, motor x, motor v per axis; material length and length per
  span), per axis the friction direction and gear contact, M motor rows, M rows of past torques, pieces of other
web;
- inputs: boundary, M motor rows (mode, set point, slope, limit), K rates of length.

Axes are the rollers in the direction of the web, K + 1 where there are spans, then the carriages. Motor k drives axis
k; of an axis that is not driven it is never on. Motors beyond the last axis (load motors of a rig) are on the roller's
side of the gear play of the axis named in their row. Without a span the tension behind the line is a force on its axis,
and a unit of position may be a radian as well (`hilbench.plant.servo_axis.layout`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from math import inf, pi, sin
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hilbench.plant import drive_loops as loops
from hilbench.plant.effect import Domain, Effect, MachineKind, Section
from hilbench.plant.effects import EFFECTS, find_effect
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.parameters import DriveParameters, EffectEntry, LoadMotorParameters, per_item
from hilbench.plant.web_line.parameters import ModelParameters, places_of
from hilbench.plant.web_line.stations import IdlerRollers, LineCarriage, Reel, Station, station_name

Vector = NDArray[np.float64]

# Web row.
W_AXES: Final = 0
W_MOTORS: Final = 1
W_SPANS: Final = 2
W_SAMPLE_TIME_S: Final = 3
W_SUBSTEPS: Final = 4  #: integration steps per sample time
W_UPSTREAM_STIFFNESS_N: Final = 5
W_DOWNSTREAM_STIFFNESS_N: Final = 6
# Axis rows.
A_RADIUS_M: Final = 0
A_MOTOR_MASS_KG: Final = 1  #: on the motor's side of the gear play
A_ROLLER_MASS_KG: Final = 2  #: on the roller's side
A_WEB_LOAD: Final = 3
A_AXIS: Final = 4  #: number of the driven axis, from 1; 0 of a roller without a motor, or a carriage
A_REEL_SLOPE_PER_M: Final = 5  #: of a reel: change of the radius over that at the start, per m; 0: no reel
A_CORE_RATIO: Final = 6  #: of a reel: radius of the core over that at the start
A_WOUND_KG: Final = 7  #: of a reel: J/r² of a web wound from nothing to the radius at the start
A_FORCE_N: Final = 8  #: of a carriage, as all following ones
A_SPRING_N_PER_M: Final = 9
A_SPRING_REST_M: Final = 10
A_ARM_M: Final = 11  #: 0: linear guide
A_LOWER_STOP_M: Final = 12
A_UPPER_STOP_M: Final = 13
A_FIRST_SPAN: Final = 14  #: first span lengthened by its travel, from 0
A_LAST_SPAN: Final = 15
A_RADIUS_SHARE: Final = 16  #: of a reel: relative error of the assumed radius at the start
A_COULOMB_N: Final = 17  #: dry friction, without effects, as all following ones
A_VISCOUS: Final = 18  #: N·s/m
A_UNBALANCE_NM: Final = 19
A_UNBALANCE_PHASE: Final = 20
A_M_PER_TURNED_RAD: Final = 21  #: position per angle of what is unbalanced
A_FIXED: Final = 22  #: effects from here on
# Motor rows.
M_RAD_PER_M: Final = 0  #: i/r
M_LOOPS: Final = 1  #: from here on as in `drive_loops`
M_KP: Final = M_LOOPS + loops.KP
M_KI: Final = M_LOOPS + loops.KI
M_POSITION_KP: Final = M_LOOPS + loops.POSITION_KP
M_LIMIT_NM: Final = M_LOOPS + loops.LIMIT_NM
M_CURRENT_S: Final = M_LOOPS + loops.CURRENT_S
M_AXIS: Final = M_LOOPS + loops.LOOPS_SIZE  #: axis of its shaft, from 0; arbitrary for a motor beyond the last axis
# Span rows.
SP_SECTION_M2: Final = 0
SP_MODULUS_PA: Final = 1
M_FIXED: Final = M_AXIS + 1  #: effects from here on
_FIXED = {"web": 7, "axis": A_FIXED, "motor": M_FIXED, "span": 2}

# State.
S_COUNT: Final = 0
S_Y: Final = 1
SA_DIRECTION: Final = 0  #: of the dry friction: -1, 1, or 0 (sticks)
SA_CONTACT: Final = 1  #: gear flank, of a carriage the stop: -1, 1, or 0 (in the play, between the stops)
SA_SIZE: Final = 2
SM_TORQUE_NM: Final = loops.TORQUE_NM
SM_COMMAND_NM: Final = loops.COMMAND_NM
SM_INTEGRAL_NM: Final = loops.INTEGRAL_NM
SM_REFERENCE: Final = loops.REFERENCE
SM_LIMITED: Final = loops.LIMITED
SM_MODE: Final = loops.MODE
SM_MEAN_NM: Final = loops.STATE_SIZE  #: mean torque in the last call of the kernel
SM_SIZE: Final = loops.STATE_SIZE + 1
RING: Final = 128  #: past torques kept per motor, one per sample time
# Pieces of other web in the line, after the past torques: a ring of the last ones.
PIECES_CAME: Final = 0  #: whether the splice of the present effect has come in
PIECES_COUNT: Final = 1  #: number that came in since the line was last without any
PIECES_FIRST: Final = 2
PIECE_FRONT_M: Final = 0  #: web position at roller 1 when the piece came in
PIECE_LENGTH_M: Final = 1  #: unstretched
PIECE_CHANGE: Final = 2  #: relative change of E·S
PIECE_SIZE: Final = 3
PIECES: Final = 8  #: capacity
PIECES_SIZE: Final = PIECES_FIRST + PIECES * PIECE_SIZE
#: Distance behind the line at which a piece is forgotten: the web may go back a little.
FORGOTTEN_BEHIND_M: Final = 1.0

# Inputs.
U_STRAIN_PREV: Final = 0
U_F_NEXT_N: Final = 1
U_MOTORS: Final = 2
UM_MODE: Final = loops.IN_MODE
UM_SETPOINT: Final = loops.IN_SETPOINT
UM_SLOPE: Final = loops.IN_SLOPE
UM_LIMIT_NM: Final = loops.IN_LIMIT_NM
UM_SIZE: Final = loops.IN_SIZE

# Scratch space: blocks as long as the integrated quantities, then parts as long as there are motors.
NOW: Final = 0  #: at the start of a step
STAGE: Final = 1  #: for the rates; after the last stage the end of the step
SUM: Final = 2  #: weighted rates of the stages so far
BLOCKS: Final = 3
TORQUE: Final = 0
TENSION: Final = 1
SPEED: Final = 2  #: of the web at the rollers
RATE: Final = 3  #: of the unstretched lengths
LENGTH_RATE: Final = 4
DECAY_HALF: Final = 5  #: of the current loops, in half a step
DECAY_FULL: Final = 6
PER_MASS: Final = 7  #: 1/kg of motor and roller together
PER_ROLLER_MASS: Final = 8
PER_MOTOR_MASS: Final = 9
STEPS: Final = 10  #: factor of the steps of E in each span in this step
DECAY_STEP_S: Final = 11  #: step length of the decays
PACE: Final = 12  #: one number: integration mode that the line's effects allow
REPORTS: Final = 13  #: one number: whether a drive's measurement or record isn't the true value, or an inertia steps
LOOP_KP: Final = 14  #: gains and current loop of a motor's drive, with effects
LOOP_KI: Final = 15
LOOP_CURRENT_S: Final = 16
SPLICE_BLUR: Final = 17  #: one number: travel of the web in a step, over which the ends of a piece are blurred, m
LAG_SHARE: Final = 18  #: share of a torque's distance to its command in its mean over a sample time
SUBSTEPS: Final = 19  #: one number: integration steps per sample time
PARTS: Final = 20
#: Least travel over which the ends of a piece are blurred, m.
LEAST_BLUR_M: Final = 1e-9
#: Integration modes: the usual step; the general one, with every force; gear play, whose contact is an event.
PLAIN: Final = 0.0
RARE: Final = 1.0
PLAY: Final = 2.0


#: Domains of a motor's effects; others of an axis belong to its roller.
_OF_A_MOTOR: Final = (
    Domain.MOTOR_TORQUE,
    Domain.TORQUE_MEASUREMENT,
    Domain.POSITION_MEASUREMENT,
    Domain.DRIVE,
)


def row_of(effect: Effect) -> str:
    """Row of an effect's parameters: "web", "axis", "motor" or "span"."""
    if not effect.per_axis:
        return "span" if effect.per_section else "web"
    return "motor" if effect.domain in _OF_A_MOTOR else "axis"


def _allocate() -> tuple[dict[str, int], dict[str, int]]:
    sizes, first = dict(_FIXED), {}
    for effect in EFFECTS:
        first[effect.id] = sizes[row_of(effect)]
        sizes[row_of(effect)] += effect.slots * len(effect.parameters)
    return sizes, first


_SIZES, _FIRST = _allocate()
W_SIZE: Final = _SIZES["web"]
A_SIZE: Final = _SIZES["axis"]
M_SIZE: Final = _SIZES["motor"]
SP_SIZE: Final = _SIZES["span"]


@cache
def place(effect_id: str, parameter: str | int, slot: int = 0) -> int:
    """Column of an effect's parameter in its row: by its name in a line, or by its number, from 0. Raises KeyError."""
    names = [p.name for effect in EFFECTS if effect.id == effect_id for p in effect.parameters]
    number = names.index(parameter) if isinstance(parameter, str) else parameter
    return _FIRST[effect_id] + slot * len(names) + number


#: Column that an effect of a carriage or idler changes, and its name in the station's block.
_CHANGED: Final = MappingProxyType(
    {
        "carriage_coulomb_friction": (place("coulomb_friction", "force_N"), "coulomb_friction_N"),
        "carriage_viscous_friction": (
            place("viscous_friction", "coefficient_N_s_per_m"),
            "viscous_friction_N_s_per_m",
        ),
        "carriage_force": (A_FORCE_N, "force_N"),
        "carriage_spring": (A_SPRING_N_PER_M, "spring_N_per_m"),
        "idler_coulomb_friction": (place("coulomb_friction", "force_N"), "roller_coulomb_friction_N"),
        "idler_viscous_friction": (
            place("viscous_friction", "coefficient_N_s_per_m"),
            "roller_viscous_friction_N_s_per_m",
        ),
    }
)
_LENGTH_ERROR: Final = place("span_length_error", "relative_change")


@dataclass(frozen=True, slots=True)
class Layout:
    """Sizes and views of the vectors of one line."""

    axes: int
    motors: int
    spans: int

    @classmethod
    def of(cls, parameters: Vector) -> Layout:
        """Layout described by a parameter vector."""
        return cls(int(parameters[W_AXES]), int(parameters[W_MOTORS]), int(parameters[W_SPANS]))

    @property
    def parameter_size(self) -> int:
        return self.first_span + self.spans * SP_SIZE

    @property
    def first_span(self) -> int:
        """Offset of the span rows in the parameters."""
        return W_SIZE + self.axes * A_SIZE + self.motors * M_SIZE

    @property
    def y_size(self) -> int:
        """Number of integrated quantities."""
        return 4 * self.axes + 2 * self.spans

    @property
    def state_size(self) -> int:
        return S_Y + self.y_size + self.axes * SA_SIZE + self.motors * (SM_SIZE + RING) + PIECES_SIZE

    @property
    def input_size(self) -> int:
        return U_MOTORS + self.motors * UM_SIZE + self.spans

    @property
    def output_size(self) -> int:
        """Number of columns of `kernel.simulate`: see `columns`."""
        return 4 * self.motors + 2 * self.spans

    @property
    def columns(self) -> Mapping[str, slice]:
        """Columns of `kernel.simulate`: motor motion at the web, measured torque, tensions, strains, mean torque."""
        return _columns(self.motors, self.spans)

    def axis_rows(self, parameters: Vector) -> Vector:
        """View of the axis rows (N, A_SIZE)."""
        return parameters[W_SIZE : W_SIZE + self.axes * A_SIZE].reshape(self.axes, A_SIZE)

    def motor_rows(self, parameters: Vector) -> Vector:
        """View of the motor rows (M, M_SIZE)."""
        return parameters[W_SIZE + self.axes * A_SIZE : self.first_span].reshape(self.motors, M_SIZE)

    def span_rows(self, parameters: Vector) -> Vector:
        """View of the span rows (K, SP_SIZE)."""
        return parameters[self.first_span :].reshape(self.spans, SP_SIZE)

    def y(self, state: Vector) -> Vector:
        """View of the integrated quantities."""
        return state[S_Y : S_Y + self.y_size]

    def motor_states(self, state: Vector) -> Vector:
        """View of the motor states (M, SM_SIZE)."""
        start = S_Y + self.y_size + self.axes * SA_SIZE
        return state[start : start + self.motors * SM_SIZE].reshape(self.motors, SM_SIZE)

    def motor_inputs(self, inputs: Vector) -> Vector:
        """View of the motor inputs (M, UM_SIZE)."""
        return inputs[U_MOTORS : U_MOTORS + self.motors * UM_SIZE].reshape(self.motors, UM_SIZE)

    def length_rates(self, inputs: Vector) -> Vector:
        """View of the rates of length (K,): m/s."""
        return inputs[U_MOTORS + self.motors * UM_SIZE :]

    def new_inputs(self) -> Vector:
        """Inputs with every motor off."""
        inputs = np.zeros(self.input_size)
        motors = self.motor_inputs(inputs)
        motors[:, UM_MODE] = MotorMode.OFF
        motors[:, UM_SLOPE] = inf
        motors[:, UM_LIMIT_NM] = inf
        return inputs

    def new_work(self) -> Vector:
        """Scratch space of the kernel; one for each line that may run at the same time."""
        return np.zeros(BLOCKS * self.y_size + PARTS * self.motors)


@cache
def _columns(motors: int, spans: int) -> Mapping[str, slice]:
    edges = {"x_m": motors, "v_m_s": motors, "tau_Nm": motors, "F_N": spans, "strain": spans, "mean_tau_Nm": motors}
    result, start = {}, 0
    for name, width in edges.items():
        result[name] = slice(start, start + width)
        start += width
    return MappingProxyType(result)


def write_effect(
    parameters: Vector,
    effect_id: str,
    axis: int | None,
    slot: int,
    values: Mapping[str, float],
    *,
    span: int | None = None,
    kind: MachineKind = MachineKind.WEB_LINE,
) -> None:
    """Write an effect's (checked) parameters, by name and in their units, into a parameter vector (P,); others stay.

    axis: number of the driven axis, from 1, None for an effect of the web; span: from 1, None for all of them; slot:
    from 0, for effects that can be given several times; kind: of the machine, which has the names and units.
    """
    layout, effect = Layout.of(parameters), find_effect(effect_id, kind)
    of = row_of(effect)
    if of == "span":
        every = layout.span_rows(parameters)
        targets = every if span is None else every[span - 1 : span]
    elif of == "web" or axis is None:
        targets = parameters[np.newaxis]
    else:
        row = driven_row(parameters, axis)
        targets = (layout.axis_rows(parameters) if of == "axis" else layout.motor_rows(parameters))[row : row + 1]
    for number, parameter in enumerate(effect.parameters):
        if parameter.name in values:
            targets[:, place(effect_id, number, slot)] = values[parameter.name]


def clear_effects(parameters: Vector, kind: MachineKind = MachineKind.WEB_LINE) -> None:
    """Set every effect of the parameter vector of a kind of machine neutral."""
    layout = Layout.of(parameters)
    rows = {
        "web": parameters[np.newaxis],
        "axis": layout.axis_rows(parameters),
        "motor": layout.motor_rows(parameters),
        "span": layout.span_rows(parameters),
    }
    for effect in EFFECTS:
        of_kind = find_effect(effect.id, kind) if kind in effect.kinds else effect
        for slot in range(effect.slots):
            for number, p in enumerate(of_kind.parameters):
                rows[row_of(effect)][:, place(effect.id, number, slot)] = p.neutral


def driven_rows(parameters: Vector) -> tuple[int, ...]:
    """Rows of the driven axes among all axes, from 0, in the order of their numbers."""
    numbers = Layout.of(parameters).axis_rows(parameters)[:, A_AXIS].astype(int).tolist()
    return tuple(row for row, number in enumerate(numbers) if number > 0)


def driven_row(parameters: Vector, axis: int) -> int:
    """Row, from 0, of a driven axis by its number, from 1."""
    first = W_SIZE + (axis - 1) * A_SIZE + A_AXIS
    return axis - 1 if parameters.item(first) == axis else driven_rows(parameters)[axis - 1]


def write_drive(row: Vector, drives: DriveParameters | None, axis: int) -> None:
    """Write the control loops of a motor row; without drives the motor has no loops and no limit."""
    row[M_KP] = per_item(drives.velocity_kp_Nm_s_per_rad, axis) if drives else 0.0
    row[M_KI] = per_item(drives.velocity_ki_Nm_per_rad, axis) if drives else 0.0
    row[M_POSITION_KP] = per_item(drives.position_kp_per_s, axis) if drives else 0.0
    row[M_LIMIT_NM] = per_item(drives.torque_limit_Nm, axis) if drives else inf
    row[M_CURRENT_S] = per_item(drives.current_loop_time_constant_s, axis) if drives else 0.0


def write_load_motor(row: Vector, motor: LoadMotorParameters, axis: int, rad_per_m: float) -> None:
    """Write the row of a load motor on the shaft of an axis, from 1."""
    row[M_AXIS], row[M_RAD_PER_M] = axis - 1, rad_per_m
    row[M_KP] = motor.velocity_kp_Nm_s_per_rad
    row[M_KI] = motor.velocity_ki_Nm_per_rad
    row[M_POSITION_KP] = motor.position_kp_per_s
    row[M_LIMIT_NM] = motor.torque_limit_Nm
    row[M_CURRENT_S] = motor.current_loop_time_constant_s


def pack(model: ModelParameters, substeps: int = 1) -> Vector:
    """Parameter vector of a model: `substeps` integration steps per drive sample time.

    Raises ValueError for gear play without motor inertia and for a torque delay longer than is kept.
    """
    rollers, carriages = model.line_rollers, model.carriages
    axes = len(rollers) + len(carriages)
    layout = Layout(axes, axes, model.span_count if model.web else 0)
    parameters = np.zeros(layout.parameter_size)
    parameters[[W_AXES, W_MOTORS, W_SPANS]] = layout.axes, layout.motors, layout.spans
    parameters[W_SAMPLE_TIME_S] = model.drives.sample_time_s if model.drives else 0.001
    parameters[W_SUBSTEPS] = substeps
    if model.web is not None:
        parameters[W_UPSTREAM_STIFFNESS_N] = model.upstream_stiffness_N
        parameters[W_DOWNSTREAM_STIFFNESS_N] = model.downstream_stiffness_N
        for span, row in enumerate(layout.span_rows(parameters), 1):
            row[SP_SECTION_M2], row[SP_MODULUS_PA] = model.section_m2(span), model.youngs_modulus_Pa(span)
    clear_effects(parameters)
    rows, motors = layout.axis_rows(parameters), layout.motor_rows(parameters)
    motors[:, M_AXIS] = np.arange(axes)
    for row, motor, roller in zip(rows, motors, rollers, strict=False):
        if roller.axis is None:
            _write_idler(row, motor, roller.station)
        else:
            _write_driven(row, motor, model, roller.axis)
            if isinstance(roller.station, Reel):
                _write_reel(row, model, roller.station)
    for row, motor, carriage in zip(rows[len(rollers) :], motors[len(rollers) :], carriages, strict=True):
        _write_carriage(row, motor, carriage)
    write_entries(parameters, [entry for entry in model.effects if entry.station is None])
    for entry in model.effects:
        if entry.station is not None:
            values = find_effect(entry.effect).filled(entry.parameters)
            write_station_effect(parameters, model, entry.effect, entry.station, values)
    return parameters


def write_station_effect(
    parameters: Vector, model: ModelParameters, effect_id: str, name: str, values: Mapping[str, float]
) -> None:
    """Write a (checked, complete) effect of a station of the model, by its name, into a parameter vector (P,).

    Raises ValueError for a station that the model does not have.
    """
    rows, rollers = Layout.of(parameters).axis_rows(parameters), model.line_rollers
    (change,) = values.values()
    at = [row for row, roller in enumerate(rollers) if station_name(roller.station) == name]
    carried = [row for row, each in enumerate(model.carriages, len(rollers)) if each.station.name == name]
    if not at:
        raise ValueError(f"effect '{effect_id}' of station {name}, expected one of the line")
    station = rollers[at[0]].station
    if isinstance(station, Reel):
        rows[at, A_RADIUS_SHARE] = change
        return
    column, known = _CHANGED[effect_id]
    base: float = getattr(station, known)
    value = base + change if effect_id == "carriage_force" else max(base + change, 0.0)
    rows[carried if effect_id.startswith("carriage_") else at, column] = value


def _write_driven(row: Vector, motor: Vector, model: ModelParameters, axis: int) -> None:
    row[A_AXIS] = axis
    row[A_RADIUS_M] = row[A_M_PER_TURNED_RAD] = model.radius_m(axis)
    row[A_MOTOR_MASS_KG] = model.motor_mass_kg(axis)
    row[A_ROLLER_MASS_KG] = model.roller_mass_kg(axis)
    row[A_WEB_LOAD] = model.carries_web_load(axis)
    motor[M_RAD_PER_M] = model.motor_rad_per_m(axis)
    write_drive(motor, model.drives, axis)


def _write_idler(row: Vector, motor: Vector, station: Station | None) -> None:
    assert isinstance(station, IdlerRollers), "a roller without a motor has a station of its own"
    row[A_RADIUS_M] = row[A_M_PER_TURNED_RAD] = station.radius_m
    row[A_ROLLER_MASS_KG] = station.inertia_kg_m2 / station.radius_m**2
    row[A_WEB_LOAD] = 1.0
    row[place("coulomb_friction", "force_N")] = station.roller_coulomb_friction_N
    row[place("viscous_friction", "coefficient_N_s_per_m")] = station.roller_viscous_friction_N_s_per_m
    motor[M_RAD_PER_M] = 1.0 / station.radius_m
    write_drive(motor, None, 1)


def _write_reel(row: Vector, model: ModelParameters, reel: Reel) -> None:
    winds, span = (-1.0, 1) if reel.type == "unwinder" else (1.0, model.span_count)
    radius_m, web = row[A_RADIUS_M], model.required_web
    row[A_REEL_SLOPE_PER_M] = winds * per_item(web.thickness_m, span) / (2.0 * pi * radius_m**2)
    row[A_CORE_RATIO] = reel.core_radius_m / radius_m
    row[A_WOUND_KG] = 0.5 * pi * reel.density_kg_m3 * per_item(web.width_m, span) * radius_m**2


def _write_carriage(row: Vector, motor: Vector, carriage: LineCarriage) -> None:
    station = carriage.station
    row[A_RADIUS_M], row[A_ROLLER_MASS_KG], row[A_WEB_LOAD] = 1.0, station.mass_kg, 1.0
    row[A_FORCE_N] = station.force_N
    row[A_SPRING_N_PER_M], row[A_SPRING_REST_M] = station.spring_N_per_m, station.spring_rest_m
    row[A_ARM_M] = station.arm_length_m
    row[A_LOWER_STOP_M] = -inf if station.lower_stop_m is None else station.lower_stop_m
    row[A_UPPER_STOP_M] = inf if station.upper_stop_m is None else station.upper_stop_m
    row[A_FIRST_SPAN], row[A_LAST_SPAN] = carriage.first_span - 1, carriage.last_span - 1
    row[place("coulomb_friction", "force_N")] = station.coulomb_friction_N
    row[place("viscous_friction", "coefficient_N_s_per_m")] = station.viscous_friction_N_s_per_m
    motor[M_RAD_PER_M] = 1.0
    write_drive(motor, None, 1)


def write_entries(parameters: Vector, entries: Iterable[EffectEntry]) -> None:
    """Write the effects of a config; those that can be given several times fill their slots in order.

    Raises ValueError as `check_effects`, and when there are more than slots.
    """
    used: Counter[tuple[str, Section | None]] = Counter()
    spans = Layout.of(parameters).spans
    for entry in entries:
        effect = find_effect(entry.effect, entry.machine_kind)
        for at in places_of(effect, entry.axis, entry.span, spans):
            slot = used[effect.id, at]
            used[effect.id, at] += 1
            if slot >= effect.slots:
                raise ValueError(f"effect '{effect.id}' is given more than {effect.slots} times at one place")
            values = effect.filled(entry.parameters)
            write_effect(
                parameters,
                effect.id,
                entry.axis,
                slot,
                values,
                span=at if isinstance(at, int) and effect.per_section else None,
                kind=entry.machine_kind,
            )
    check_effects(parameters)


def check_effects(parameters: Vector) -> None:
    """Raise ValueError for effects impossible on this line: gear play without motor inertia, too long a delay."""
    layout = Layout.of(parameters)
    if layout.spans:
        check_play(parameters)
    longest = (RING - 2) * parameters[W_SAMPLE_TIME_S]
    for at in driven_rows(parameters):
        row, motor = layout.axis_rows(parameters)[at], layout.motor_rows(parameters)[at]
        axis, play = int(row[A_AXIS]), row[place("backlash", "gap_rad")] > 0.0
        if play and row[A_REEL_SLOPE_PER_M] != 0.0:
            raise ValueError(f"effect 'backlash' at axis {axis}, expected none at a reel")
        delay_s = motor[place("torque_delay", "delay_s")]
        if delay_s > longest:
            raise ValueError(f"effect 'torque_delay' of {delay_s:g} s, expected at most {longest:g} s at axis {axis}")


def check_play(parameters: Vector) -> None:
    """Raise ValueError for gear play without inertia on both sides, which can't be simulated (the inverse of a single
    axis does not need it)."""
    layout = Layout.of(parameters)
    for at in driven_rows(parameters):
        row = layout.axis_rows(parameters)[at]
        if row[place("backlash", "gap_rad")] > 0.0 and min(row[A_MOTOR_MASS_KG], row[A_ROLLER_MASS_KG]) <= 0.0:
            raise ValueError(
                f"effect 'backlash' at axis {int(row[A_AXIS])}, expected inertia on both sides of the gear"
            )


def new_state(parameters: Vector, strain: float | Vector = 0.0, length_m: float | Vector = 1.0) -> Vector:
    """State at rest, at position zero, with the given strains and (nominal) lengths of the spans."""
    layout = Layout.of(parameters)
    state = np.zeros(layout.state_size)
    y, n, k = layout.y(state), layout.axes, layout.spans
    y[4 * n + k :] = length_m
    set_strain(parameters, state, strain)
    return state


def set_strain(parameters: Vector, state: Vector, strain: ArrayLike) -> None:
    """Set the strain of every span (state transfer): material length = length/(1 + strain)."""
    layout = Layout.of(parameters)
    k, material = layout.spans, S_Y + 4 * layout.axes
    strains = np.asarray(strain, dtype=float)
    for span, of_span in enumerate(strains.tolist() if strains.ndim else [float(strains)] * k):
        factor = length_factor(parameters, layout, span + 1)
        state[material + span] = state.item(material + k + span) * factor / (1.0 + of_span)


def length_factor(parameters: Vector, layout: Layout, span: int) -> float:
    """Factor on the nominal length of a span, from 1, by scalar access."""
    return 1.0 + parameters.item(layout.first_span + (span - 1) * SP_SIZE + _LENGTH_ERROR)


def strand_length_m(carriage: Vector, x_m: float) -> float:
    """Length that a carriage at x adds to each of its strands; `carriage`: the row of its axis."""
    arm = float(carriage[A_ARM_M])
    return arm * sin(x_m / arm) if arm else x_m


def await_splice(state: Vector) -> None:
    """Await a splice; pieces that came in before stay in the web."""
    state[PIECES_CAME - PIECES_SIZE] = 0.0


def forget_pieces(state: Vector) -> None:
    """Remove all pieces from the web, and await a splice."""
    state[-PIECES_SIZE:] = 0.0


def refresh_modes(parameters: Vector, state: Vector) -> None:
    """Set friction direction and gear contact by the motion after external changes of state or effects."""
    n, gap = int(parameters[W_AXES]), W_SIZE + place("backlash", "gap_rad")
    behind = W_SIZE + place("resonance", "inertia_share")
    modes = S_Y + 4 * n + 2 * int(parameters[W_SPANS])
    for axis in range(n):  # scalar access: of two axes, every cycle, a fifth of numpy's time
        speed = state.item(S_Y + n + axis)
        state[modes + axis * SA_SIZE + SA_DIRECTION] = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else speed
        if parameters[gap + axis * A_SIZE] == 0.0 == parameters[behind + axis * A_SIZE]:
            state[modes + axis * SA_SIZE + SA_CONTACT] = 0.0
            state[S_Y + 3 * n + axis] = speed
