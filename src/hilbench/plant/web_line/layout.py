"""Layout of the kernel's flat arrays. Fields of effects follow from the table of effects.

Three vectors of float64 describe a line of N axes, M motors and K spans, in records whose fields have names:

- parameters: `WEB`, N times `AXIS`, M times `MOTOR`, K times `SPAN` (the counts come first, so the vector is
  self-describing);
- state: sample counter, the integrated quantities (x, v, motor x, motor v per axis; material length and length per
  span), N times `MODE`, M times `DRIVE`, M rows of past torques, `WEB_PIECES`;
- inputs: `BOUNDARY`, M times `DRIVE_INPUT`, K rates of length.

Compiled code takes them from the vectors by `hilbench.plant.web_line.records`.

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
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from hilbench.compiled import Vector, record_at, record_type
from hilbench.plant.drive_loops import DRIVE as DRIVE
from hilbench.plant.drive_loops import DRIVE_INPUT as DRIVE_INPUT
from hilbench.plant.effect import Domain, Effect, MachineKind, Section
from hilbench.plant.effects import EFFECTS, find_effect
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.parameters import DriveParameters, EffectEntry, LoadMotorParameters, per_item
from hilbench.plant.web_line.parameters import ModelParameters, places_of
from hilbench.plant.web_line.stations import IdlerRollers, LineCarriage, Reel, Station, station_name


def _row_of(effect: Effect) -> str:
    """Row of an effect's parameters: "web", "axis", "motor" or "span"."""
    if not effect.per_axis:
        return "span" if effect.per_section else "web"
    return "motor" if effect.domain in _OF_A_MOTOR else "axis"


#: Domains of a motor's effects; others of an axis belong to its roller.
_OF_A_MOTOR: Final = (
    Domain.MOTOR_TORQUE,
    Domain.TORQUE_MEASUREMENT,
    Domain.POSITION_MEASUREMENT,
    Domain.DRIVE,
)


def _row(of: str, *names: str) -> np.dtype[Any]:
    """Type of a row: its own fields; then by id each effect in it, a record of its parameters, or, of one that can be
    given several times, (slots, parameters)."""
    fields: list[Any] = [(name, np.float64) for name in names]
    for effect in EFFECTS:
        if _row_of(effect) == of and effect.slots > 1:
            fields.append((effect.id, np.float64, (effect.slots, len(effect.parameters))))
        elif _row_of(effect) == of:
            fields.append((effect.id, record_type(*(parameter.name for parameter in effect.parameters))))
    return np.dtype(fields)


WEB: Final = _row(
    *("web", "axes", "motors", "spans", "sample_time_s"),
    "substeps",  # integration steps per sample time
    *("upstream_stiffness_N", "downstream_stiffness_N"),
)
AXIS: Final = _row(
    *("axis", "radius_m"),
    "motor_mass_kg",  # on the motor's side of the gear play
    "roller_mass_kg",  # on the roller's side; all that turns without a play
    "web_load",
    "number",  # of the driven axis, from 1; 0 of a roller without a motor, or a carriage
    "reel_slope_per_m",  # of a reel: change of the radius over that at the start, per m; 0: no reel
    "core_ratio",  # of a reel: radius of the core over that at the start
    "wound_kg",  # of a reel: J/r² of a web wound from nothing to the radius at the start
    *("force_N", "spring_N_per_m", "spring_rest_m"),  # of a carriage, as those up to the last span
    "arm_m",  # 0: linear guide
    *("lower_stop_m", "upper_stop_m"),
    *("first_span", "last_span"),  # spans lengthened by its travel, from 0
    "radius_share",  # of a reel: relative error of the assumed radius at the start
    *("coulomb_N", "viscous_N_s_per_m", "unbalance_Nm", "unbalance_phase_rad"),  # without effects
    "m_per_turned_rad",  # position per angle of what is unbalanced
)
MOTOR: Final = _row(
    "motor",
    "rad_per_m",  # i/r
    *("kp", "ki", "position_kp", "limit_Nm", "current_s"),  # of its drive's loops, motor side
    "axis",  # of its shaft, from 0; arbitrary for a motor beyond the last axis
)
SPAN: Final = _row("span", "section_m2", "modulus_Pa")
KINDS: Final = MappingProxyType({"web": WEB, "axis": AXIS, "motor": MOTOR, "span": SPAN})
W_SIZE, A_SIZE, M_SIZE, SP_SIZE = (kind.itemsize // 8 for kind in KINDS.values())
W_SAMPLE_TIME_S: Final = WEB.names.index("sample_time_s") if WEB.names else 0

# State: of an axis, the direction of the dry friction: -1, 1, or 0 (sticks); its contact is the gear flank, of a
# carriage the stop: -1, 1, or 0 (in the play, between the stops).
S_COUNT: Final = 0
S_Y: Final = 1
MODE: Final = record_type("direction", "contact")
MODE_SIZE: Final = MODE.itemsize // 8
DRIVE_SIZE: Final = DRIVE.itemsize // 8
RING: Final = 128  #: past torques kept per motor, one per sample time
PIECES: Final = 8  #: capacity
# Pieces of other web in the line, after the past torques: whether the splice of the present effect has come in; number
# that came in since the line was last without any; ring of the last ones: web position at roller 1 when the piece came
# in (m), unstretched length (m), relative change of E·S.
WEB_PIECES: Final = np.dtype([("came", np.float64), ("count", np.float64), ("ring", np.float64, (PIECES, 3))])
PIECES_SIZE: Final = WEB_PIECES.itemsize // 8
#: Distance behind the line at which a piece is forgotten: the web may go back a little.
FORGOTTEN_BEHIND_M: Final = 1.0
#: Least travel over which the ends of a piece are blurred, m.
LEAST_BLUR_M: Final = 1e-9

# Inputs.
BOUNDARY: Final = record_type("strain_prev", "F_next_N")
U_MOTORS: Final = BOUNDARY.itemsize // 8
UM_SIZE: Final = DRIVE_INPUT.itemsize // 8
UM_SETPOINT: Final = 1

# Scratch space: blocks as long as the integrated quantities, then a call's settings, then a row for each motor, which
# is as well that of an axis, and of the span after a roller.
NOW: Final = 0  #: at the start of a step
STAGE: Final = 1  #: for the rates; after the last stage the end of the step
SUM: Final = 2  #: weighted rates of the stages so far
BLOCKS: Final = 3
CALL: Final = record_type(
    "integration",  # integration mode that the line's effects allow
    "reports",  # whether a drive's measurement or record isn't the true value, or an inertia steps
    "substeps",  # integration steps per sample time
    "decay_step_s",  # step length of the decays
    "blur_m",  # travel of the web in a step, over which the ends of a piece are blurred
)
CALL_SIZE: Final = CALL.itemsize // 8
PART: Final = record_type(
    *("torque_Nm", "tension_N"),
    "speed_m_s",  # of the web at the rollers
    *("rate_m_s", "length_rate_m_s"),  # of the unstretched and of the nominal length
    *("decay_half", "decay_full"),  # of the current loop, in half a step and a step
    *("per_kg", "per_roller_kg", "per_motor_kg"),  # 1/mass: of both together, of each
    "step_factor",  # of the steps of E in this step
    *("kp", "ki", "current_s"),  # of the drive's loops, with effects
    "lag_share",  # share of a torque's distance to its command in its mean over a sample time
)
PART_SIZE: Final = PART.itemsize // 8
#: Integration modes: the usual step; the general one, with every force; gear play, whose contact is an event; the web
#: alone, where every roller is held.
USUAL: Final = 0.0
GENERAL: Final = 1.0
WITH_PLAY: Final = 2.0
HELD: Final = 3.0


def column(kind: np.dtype[Any], field: str) -> int:
    """Column of a field in a row, or its first one."""
    assert kind.fields is not None, "a type of a record"
    return kind.fields[field][1] // 8


@cache
def place(effect_id: str, parameter: str | int, slot: int = 0) -> int:
    """Column of an effect's parameter in its row: by its name in a line, or by its number, from 0. Raises KeyError."""
    effect = {each.id: each for each in EFFECTS}[effect_id]
    names = [p.name for p in effect.parameters]
    number = names.index(parameter) if isinstance(parameter, str) else parameter
    return column(KINDS[_row_of(effect)], effect_id) + slot * len(names) + number


#: Column that an effect of a carriage or idler changes, and its name in the station's block.
_CHANGED: Final = MappingProxyType(
    {
        f"{part}_{effect}_friction": (place(f"{effect}_friction", 0), f"{prefix}{effect}_friction_{unit}")
        for part, prefix in (("carriage", ""), ("idler", "roller_"))
        for effect, unit in (("coulomb", "N"), ("viscous", "N_s_per_m"))
    }
    | {
        "carriage_force": (column(AXIS, "force_N"), "force_N"),
        "carriage_spring": (column(AXIS, "spring_N_per_m"), "spring_N_per_m"),
    }
)


@dataclass(frozen=True, slots=True)
class Layout:
    """Sizes and views of the vectors of one line."""

    axes: int
    motors: int
    spans: int

    @classmethod
    def of(cls, parameters: Vector) -> Layout:
        """Layout described by a parameter vector."""
        axes, motors, spans = parameters[:3].tolist()
        return cls(int(axes), int(motors), int(spans))

    @property
    def first_motor(self) -> int:
        """Offset of the motor rows in the parameters."""
        return W_SIZE + self.axes * A_SIZE

    @property
    def first_span(self) -> int:
        """Offset of the span rows in the parameters."""
        return self.first_motor + self.motors * M_SIZE

    @property
    def y_size(self) -> int:
        """Number of integrated quantities."""
        return 4 * self.axes + 2 * self.spans

    @property
    def first_drive(self) -> int:
        """Offset of the states of the drives in the state."""
        return S_Y + self.y_size + self.axes * MODE_SIZE

    @property
    def state_size(self) -> int:
        return self.first_drive + self.motors * (DRIVE_SIZE + RING) + PIECES_SIZE

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

    def matrices(self, parameters: Vector) -> dict[str, Vector]:
        """Views of the rows of web (1, W_SIZE), axes (N, A_SIZE), motors (M, M_SIZE) and spans (K, SP_SIZE)."""
        ends = np.cumsum([W_SIZE, self.axes * A_SIZE, self.motors * M_SIZE])
        parts = zip(KINDS.items(), np.split(parameters, ends), strict=True)
        return {name: part.reshape(-1, kind.itemsize // 8) for (name, kind), part in parts}

    def axis_rows(self, parameters: Vector) -> Any:
        """View of the axis rows (N,)."""
        return _records(parameters, W_SIZE, self.axes, AXIS)

    def motor_rows(self, parameters: Vector) -> Any:
        """View of the motor rows (M,)."""
        return _records(parameters, self.first_motor, self.motors, MOTOR)

    def span_rows(self, parameters: Vector) -> Any:
        """View of the span rows (K,)."""
        return _records(parameters, self.first_span, self.spans, SPAN)

    def y(self, state: Vector) -> Vector:
        """View of the integrated quantities."""
        return state[S_Y : S_Y + self.y_size]

    def modes(self, state: Vector) -> Any:
        """View of the axes' modes (N,)."""
        return _records(state, S_Y + self.y_size, self.axes, MODE)

    def motor_states(self, state: Vector) -> Any:
        """View of the states of the drives (M,)."""
        return _records(state, self.first_drive, self.motors, DRIVE)

    def motor_inputs(self, inputs: Vector) -> Any:
        """View of the motor inputs (M,)."""
        return _records(inputs, U_MOTORS, self.motors, DRIVE_INPUT)

    def length_rates(self, inputs: Vector) -> Vector:
        """View of the rates of length (K,): m/s."""
        return inputs[U_MOTORS + self.motors * UM_SIZE :]

    def new_inputs(self) -> Vector:
        """Inputs with every motor off."""
        inputs = np.zeros(self.input_size)
        motors = self.motor_inputs(inputs)
        motors.mode, motors.slope, motors.limit_Nm = MotorMode.OFF, inf, inf
        return inputs

    def new_work(self) -> Vector:
        """Scratch space of the kernel; one for each line that may run at the same time."""
        return np.zeros(BLOCKS * self.y_size + CALL_SIZE + PART_SIZE * self.motors)


def _records(vector: Vector, first: int, count: int, kind: np.dtype[Any]) -> Any:
    return vector[first : first + count * kind.itemsize // 8].view(kind).view(np.recarray)


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
    of = _row_of(effect)
    targets = layout.matrices(parameters)[of]
    if of == "span":
        targets = targets if span is None else targets[span - 1 : span]
    elif axis is not None and of != "web":
        row = driven_row(parameters, axis)
        targets = targets[row : row + 1]
    for number, parameter in enumerate(effect.parameters):
        if parameter.name in values:
            targets[:, place(effect_id, number, slot)] = values[parameter.name]


def clear_effects(parameters: Vector, kind: MachineKind = MachineKind.WEB_LINE) -> None:
    """Set every effect of the parameter vector of a kind of machine neutral."""
    rows = Layout.of(parameters).matrices(parameters)
    for effect in EFFECTS:
        of_kind = find_effect(effect.id, kind) if kind in effect.kinds else effect
        for slot in range(effect.slots):
            for number, p in enumerate(of_kind.parameters):
                rows[_row_of(effect)][:, place(effect.id, number, slot)] = p.neutral


def driven_rows(parameters: Vector) -> tuple[int, ...]:
    """Rows of the driven axes among all axes, from 0, in the order of their numbers."""
    numbers = Layout.of(parameters).axis_rows(parameters).number.tolist()
    return tuple(row for row, number in enumerate(numbers) if number > 0)


def driven_row(parameters: Vector, axis: int) -> int:
    """Row, from 0, of a driven axis by its number, from 1."""
    first = W_SIZE + (axis - 1) * A_SIZE + column(AXIS, "number")
    return axis - 1 if parameters.item(first) == axis else driven_rows(parameters)[axis - 1]


def write_drive(row: Any, drives: DriveParameters | LoadMotorParameters | None, axis: int) -> None:
    """Write the control loops of a `MOTOR`; without drives it has no loops and no limit."""
    row.kp = per_item(drives.velocity_kp_Nm_s_per_rad, axis) if drives else 0.0
    row.ki = per_item(drives.velocity_ki_Nm_per_rad, axis) if drives else 0.0
    row.position_kp = per_item(drives.position_kp_per_s, axis) if drives else 0.0
    row.limit_Nm = per_item(drives.torque_limit_Nm, axis) if drives else inf
    row.current_s = per_item(drives.current_loop_time_constant_s, axis) if drives else 0.0


def write_load_motor(row: Any, motor: LoadMotorParameters, axis: int, rad_per_m: float) -> None:
    """Write the `MOTOR` of a load motor on the shaft of an axis, from 1."""
    row.axis, row.rad_per_m = axis - 1, rad_per_m
    write_drive(row, motor, axis)


def new_parameters(layout: Layout, sample_time_s: float, substeps: int, kind: MachineKind) -> Vector:
    """Parameter vector of a line without parts and effects."""
    parameters = np.zeros(layout.first_span + layout.spans * SP_SIZE)
    counts = layout.axes, layout.motors, layout.spans
    parameters[: W_SAMPLE_TIME_S + 2] = *counts, sample_time_s, substeps
    clear_effects(parameters, kind)
    return parameters


def pack(model: ModelParameters, substeps: int = 1) -> Vector:
    """Parameter vector of a model: `substeps` integration steps per drive sample time.

    Raises ValueError for gear play without motor inertia and for a torque delay longer than is kept.
    """
    rollers, carriages = model.line_rollers, model.carriages
    axes = len(rollers) + len(carriages)
    layout = Layout(axes, axes, model.span_count if model.web else 0)
    sample_time_s = model.drives.sample_time_s if model.drives else 0.001
    parameters = new_parameters(layout, sample_time_s, substeps, MachineKind.WEB_LINE)
    if model.web is not None:
        web = record_at(parameters, WEB)
        web.upstream_stiffness_N, web.downstream_stiffness_N = model.upstream_stiffness_N, model.downstream_stiffness_N
        for span, row in enumerate(layout.span_rows(parameters), 1):
            row.section_m2, row.modulus_Pa = model.section_m2(span), model.youngs_modulus_Pa(span)
    rows, motors = layout.axis_rows(parameters), layout.motor_rows(parameters)
    motors.axis = np.arange(axes)
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
    rows, rollers = Layout.of(parameters).matrices(parameters)["axis"], model.line_rollers
    (change,) = values.values()
    at = [row for row, roller in enumerate(rollers) if station_name(roller.station) == name]
    carried = [row for row, each in enumerate(model.carriages, len(rollers)) if each.station.name == name]
    if not at:
        raise ValueError(f"effect '{effect_id}' of station {name}, expected one of the line")
    station = rollers[at[0]].station
    if isinstance(station, Reel):
        rows[at, column(AXIS, "radius_share")] = change
        return
    changed, known = _CHANGED[effect_id]
    base: float = getattr(station, known)
    value = base + change if effect_id == "carriage_force" else max(base + change, 0.0)
    rows[carried if effect_id.startswith("carriage_") else at, changed] = value


def _write_driven(row: Any, motor: Any, model: ModelParameters, axis: int) -> None:
    row.number, row.web_load = axis, model.carries_web_load(axis)
    row.radius_m = row.m_per_turned_rad = model.radius_m(axis)
    row.motor_mass_kg, row.roller_mass_kg = model.motor_mass_kg(axis), model.roller_mass_kg(axis)
    motor.rad_per_m = model.motor_rad_per_m(axis)
    write_drive(motor, model.drives, axis)


def _write_idler(row: Any, motor: Any, station: Station | None) -> None:
    assert isinstance(station, IdlerRollers), "a roller without a motor has a station of its own"
    row.radius_m = row.m_per_turned_rad = station.radius_m
    row.roller_mass_kg, row.web_load = station.inertia_kg_m2 / station.radius_m**2, 1.0
    row.coulomb_friction.force_N = station.roller_coulomb_friction_N
    row.viscous_friction.coefficient_N_s_per_m = station.roller_viscous_friction_N_s_per_m
    motor.rad_per_m = 1.0 / station.radius_m
    write_drive(motor, None, 1)


def _write_reel(row: Any, model: ModelParameters, reel: Reel) -> None:
    winds, span = (-1.0, 1) if reel.type == "unwinder" else (1.0, model.span_count)
    radius_m, web = row.radius_m, model.required_web
    row.reel_slope_per_m = winds * per_item(web.thickness_m, span) / (2.0 * pi * radius_m**2)
    row.core_ratio = reel.core_radius_m / radius_m
    row.wound_kg = 0.5 * pi * reel.density_kg_m3 * per_item(web.width_m, span) * radius_m**2


def _write_carriage(row: Any, motor: Any, carriage: LineCarriage) -> None:
    station = carriage.station
    row.radius_m, row.roller_mass_kg, row.web_load = 1.0, station.mass_kg, 1.0
    row.force_N, row.arm_m = station.force_N, station.arm_length_m
    row.spring_N_per_m, row.spring_rest_m = station.spring_N_per_m, station.spring_rest_m
    row.lower_stop_m = -inf if station.lower_stop_m is None else station.lower_stop_m
    row.upper_stop_m = inf if station.upper_stop_m is None else station.upper_stop_m
    row.first_span, row.last_span = carriage.first_span - 1, carriage.last_span - 1
    row.coulomb_friction.force_N = station.coulomb_friction_N
    row.viscous_friction.coefficient_N_s_per_m = station.viscous_friction_N_s_per_m
    motor.rad_per_m = 1.0
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
    rows, motors = layout.axis_rows(parameters), layout.motor_rows(parameters)
    for at in driven_rows(parameters):
        axis, delay_s = int(rows[at].number), motors[at].torque_delay.delay_s
        if rows[at].backlash.gap_rad > 0.0 and rows[at].reel_slope_per_m != 0.0:
            raise ValueError(f"effect 'backlash' at axis {axis}, expected none at a reel")
        if delay_s > longest:
            raise ValueError(f"effect 'torque_delay' of {delay_s:g} s, expected at most {longest:g} s at axis {axis}")


def check_play(parameters: Vector) -> None:
    """Raise ValueError for gear play without inertia on both sides, which can't be simulated (the inverse of a single
    axis does not need it)."""
    for row in Layout.of(parameters).axis_rows(parameters):
        if row.number > 0.0 and row.backlash.gap_rad > 0.0 and min(row.motor_mass_kg, row.roller_mass_kg) <= 0.0:
            raise ValueError(f"effect 'backlash' at axis {int(row.number)}, expected inertia on both sides of the gear")


def new_state(parameters: Vector, strain: float | Vector = 0.0, length_m: float | Vector = 1.0) -> Vector:
    """State at rest, at position zero, with the given strains and (nominal) lengths of the spans."""
    layout = Layout.of(parameters)
    state = np.zeros(layout.state_size)
    layout.y(state)[4 * layout.axes + layout.spans :] = length_m
    set_strain(parameters, state, strain)
    return state


def set_strain(parameters: Vector, state: Vector, strain: ArrayLike) -> None:
    """Set the strain of every span (state transfer): material length = length/(1 + strain)."""
    layout = Layout.of(parameters)
    k, material = layout.spans, S_Y + 4 * layout.axes
    strains = np.asarray(strain, dtype=float)
    for span, of_span in enumerate(strains.tolist() if strains.ndim else [float(strains)] * k):
        factor = factor_on_length(parameters, layout, span + 1)
        state[material + span] = state.item(material + k + span) * factor / (1.0 + of_span)


def factor_on_length(parameters: Vector, layout: Layout, span: int) -> float:
    """Factor on the nominal length of a span, from 1, by scalar access."""
    error = place("span_length_error", "relative_change")
    return 1.0 + parameters.item(layout.first_span + (span - 1) * SP_SIZE + error)


def strand_length_m(carriage: Any, x_m: float) -> float:
    """Length that a carriage at x adds to each of its strands; `carriage`: the row of its axis."""
    arm = float(carriage.arm_m)
    return arm * sin(x_m / arm) if arm else x_m


def await_splice(state: Vector) -> None:
    """Await a splice; pieces that came in before stay in the web."""
    state[-PIECES_SIZE] = 0.0


def forget_pieces(state: Vector) -> None:
    """Remove all pieces from the web, and await a splice."""
    state[-PIECES_SIZE:] = 0.0


def refresh_modes(parameters: Vector, state: Vector) -> None:
    """Set friction direction and gear contact by the motion after external changes of state or effects."""
    layout = Layout.of(parameters)
    gap, behind = W_SIZE + place("backlash", "gap_rad"), W_SIZE + place("resonance", "inertia_share")
    for axis in range(layout.axes):  # scalar access: of two axes, every cycle, a fifth of numpy's time
        speed, mode = state.item(S_Y + layout.axes + axis), S_Y + layout.y_size + axis * MODE_SIZE
        state[mode] = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else speed
        if parameters[gap + axis * A_SIZE] == 0.0 == parameters[behind + axis * A_SIZE]:
            state[mode + 1] = 0.0
            state[S_Y + 3 * layout.axes + axis] = speed
