"""Emulation of a web line by load motors, whole recordings in one compiled call: the rig's mechanics under the load
model.

In each cycle, as on the bench (`hilbench.bench.tasks.load_model`): the line (`line_follower`) is followed on the
positions of its driven rollers at SYNC, its tension is predicted over the dead time of the emulation, and the load
motor gets the torque with the next SYNC. Between them the axes turn under their drives and the load motor, without a
web. Noise and resolution are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hilbench.compiled import COUNT, CUBE, INDICES, MATRIX, REAL, VECTOR, compiled, entry_point, inlined
from hilbench.plant.motor_port import MotorMode
from hilbench.plant.sampled_shaft import emulation_delay_s
from hilbench.plant.sampling import on_all_cores, samples_per
from hilbench.plant.web_line import kernel, line_follower, line_kernel, places, reels
from hilbench.plant.web_line import layout as lay
from hilbench.plant.web_line.layout import Layout, Vector
from hilbench.plant.web_line.offline import Simulation, start_state
from hilbench.plant.web_line.parameters import ModelParameters
from hilbench.plant.web_line.rig import CoupledMotor, RigParameters, pack_rig
from hilbench.plant.web_line.stability import sampled_shaft
from hilbench.plant.web_line.stations import station_name

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Emulation:
    """Settings of a bench's web emulation: its cycle, the load motors on shafts of axes, the set-point resolution."""

    #: Emulated part, for messages.
    part: ClassVar[str] = "web"

    cycle_s: float
    load_motors: tuple[CoupledMotor, ...]
    #: Resolution of each axis's velocity command, m/s at the web; None if unknown.
    resolution_m_s: tuple[float, ...] | None = None

    @classmethod
    def usual(cls, model: ModelParameters, cycle_s: float) -> Emulation:
        """Default emulation: a load motor at the last roller or, with stations, wherever the web loads a roller."""
        axes = range(1, model.axis_count + 1)
        loaded = axes[-1:] if model.stations is None else [axis for axis in axes if model.carries_web_load(axis)]
        return cls(cycle_s, tuple(CoupledMotor(axis=axis) for axis in loaded))

    def as_taken(self, commands_m_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Velocity commands (n, N), m/s, rounded to the drives' units."""
        if self.resolution_m_s is None:
            return commands_m_s
        units = np.array(self.resolution_m_s)
        return np.asarray(np.round(commands_m_s / units) * units)


def lead_s(model: ModelParameters, cycle_s: float) -> float:
    """Dead time from measured motion to the torque of a load motor, by a model; the tension is predicted over it.

    Raises ValueError for a model without drives.
    """
    return emulation_delay_s(sampled_shaft(model, cycle_s=cycle_s))


@inlined
def _show(p: Vector, s: Vector, sensors: Rows, out: Vector, at: int) -> None:
    """Write the readings of `sensors` (rows of the line) to `out` from offset `at` on, m."""
    for j in range(len(sensors)):
        axis, x = places.axis(sensors[j]), s[lay.S_Y + sensors[j]]
        out[at + j] = p[axis + lay.A_RADIUS_M] * reels.radius_ratio(p, axis, x) if reels.is_reel(p, axis) else x


@compiled
def _run(
    p: Vector, s: Vector, u: Vector, w: Vector, web: Vector, line: Vector, line_u: Vector, line_w: Vector, rows: Rows,
    sensors: Rows, pulls: Vector, guess: Vector, memory: Vector, further: Vector, loads: Vector, seen: Vector,
    commands: Vector, boundary: Vector, samples: int, cycle_s: float, lead_s: float, pushed: Rows, forces: Vector,
    more: Vector, out: Vector, at: int,
) -> None:  # fmt: skip
    """Row by row observe the rig, follow the line on it, and advance.

    The rig of N axes and M motors: `p`, `s`, `u`, `w`; the line of K spans on it: parameters `web`, state `line`,
    `line_u`, `line_w`, its driven rollers at `rows` (N,), their `memory` as of `line_kernel`; zero offsets `further`
    (N,). Room for a `guess` of its state, for `loads` (N,) and for its outputs `seen`; `pulls` (N,): N·m at the motor
    per N. `commands` (n, N) rad/s at the motors, `boundary` (n, 2) upstream strain and downstream tension (N), a row of
    `samples` drive samples each. Carriages `pushed`, rows of the line, get `forces` (n, C), each of which acts to the
    next row; `more` (C,): forces added by effects. Rows of 4·M + 2·K columns and the `sensors` go into `out` from
    offset `at` on.
    """
    n, m, k = int(p[lay.W_AXES]), int(p[lay.W_MOTORS]), int(web[lay.W_SPANS])
    count, first = len(rows), lay.U_MOTORS + lay.UM_SETPOINT
    columns, step_s = 4 * m + 2 * k + len(sensors), memory[line_kernel.STEP_S]
    sample_s = memory[line_kernel.SAMPLE_S]
    a, v = memory[line_kernel.FIRST + count :], memory[line_kernel.FIRST + 2 * count :]
    for i in range(len(memory) - line_kernel.FIRST):
        memory[line_kernel.FIRST + i] = 0.0
    memory[line_kernel.KNOWN] = memory[line_kernel.DURATION_S] = 0.0
    for i in range(n):
        loads[i] = 0.0
    for j in range(n, m):  # of a line that runs
        loads[int(p[places.motor(n, j) + lay.M_AXIS])] = s[places.motor_state(n, 0, j) + lay.SM_TORQUE_NM]
    kernel.enter(p, s, u, w)
    for row in range(commands.shape[0]):
        place = at + row * columns
        kernel.report(p, s, u, w, out, place)
        before = max(row - 1, 0)
        line_u[lay.U_STRAIN_PREV], line_u[lay.U_F_NEXT_N] = boundary[before, 0], boundary[before, 1]
        if row > 0:
            for j in range(len(pushed)):
                web[places.axis(pushed[j]) + lay.A_FORCE_N] = forces[before, j] + more[j]
            x = out[place : place + n]
            line_kernel.follow_to(web, line, line_u, line_w, memory, rows, x, further, cycle_s)
        # Steps of E are spread over the next cycle, so that what is found is continuous in their times.
        web[lay.W_SUBSTEPS] = sample_s / cycle_s
        line_kernel.observe(web, line, line_u, line_w, seen)
        for j in range(2 * k):
            out[place + 4 * m + j] = seen[3 * int(web[lay.W_MOTORS]) + j]
        _show(web, line, sensors, out, place + 4 * m + 2 * k)
        line_u[lay.U_STRAIN_PREV], line_u[lay.U_F_NEXT_N] = boundary[row, 0], boundary[row, 1]
        for j in range(len(line)):
            guess[j] = line[j]
        guess[lay.S_COUNT] -= lead_s / sample_s  # only the motion is predicted: the tension has the present E
        for i in range(n):
            v[i] = line[lay.S_Y + int(web[lay.W_AXES]) + rows[i]]
        line_kernel.turn(web, guess, line_u, line_w, rows, v, a, lead_s, sample_s, step_s)
        line_kernel.observe(web, guess, line_u, line_w, seen)
        for j in range(n):
            u[first + j * lay.UM_SIZE] = commands[row, j]
        for j in range(n, m):  # the torque for the measurement at the previous SYNC
            u[first + j * lay.UM_SIZE] = loads[int(p[places.motor(n, j) + lay.M_AXIS])]
        kernel.go_on(p, s, u, w, samples)
        for i in range(n):
            loads[i] = line_kernel.web_force_N(web, line, line_u, seen, rows[i]) * pulls[i]


@entry_point(
    MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, MATRIX, VECTOR, VECTOR, INDICES, INDICES, VECTOR, MATRIX, MATRIX, COUNT,
    REAL, REAL, REAL, INDICES, MATRIX, VECTOR, CUBE,
)  # fmt: skip
def _simulate(
    p: Vector, s: Vector, u: Vector, w: Vector, web: Vector, line: Vector, line_u: Vector, line_w: Vector,
    rows: Rows, sensors: Rows, pulls: Vector, commands: Vector, boundary: Vector, samples: int, cycle_s: float,
    lead_s: float, step_s: float, pushed: Rows, forces: Vector, bases: Vector, out: Vector,
) -> None:  # fmt: skip
    flat, size, count = out.reshape(-1), out.shape[1] * out.shape[2], len(rows)
    guess, memory = np.zeros(line.shape[1]), np.zeros(line_kernel.FIRST + 3 * count)
    memory[line_kernel.SAMPLE_S], memory[line_kernel.STEP_S] = web[0, lay.W_SAMPLE_TIME_S], step_s
    further, loads = np.zeros(count), np.zeros(count)
    seen = np.zeros(4 * int(web[0, lay.W_MOTORS]) + 2 * int(web[0, lay.W_SPANS]))
    first, more = u.copy(), np.zeros(len(pushed))
    for b in range(p.shape[0]):
        u[:] = first
        for j in range(len(pushed)):
            more[j] = web[b, places.axis(pushed[j]) + lay.A_FORCE_N] - bases[j]
        _run(
            p[b], s[b], u, w, web[b], line[b], line_u, line_w, rows, sensors, pulls, guess, memory, further, loads,
            seen, commands, boundary, samples, cycle_s, lead_s, pushed, forces, more, flat, b * size,
        )  # fmt: skip


def simulate_emulated(
    emulation: Emulation,
    model: ModelParameters,
    parameters: Vector,
    commands: NDArray[np.float64],
    boundary: NDArray[np.float64],
    *,
    state: Vector | None = None,
    sensors: Sequence[str] = (),
    forces_N: Mapping[str, NDArray[np.float64]] = MappingProxyType({}),
) -> Simulation:
    """Simulate recorded velocity commands on the rig of a model of N axes, its line emulated by load motors.

    parameters: (P,) or (B, P) of the model from `layout.pack`, with effects: those of the axes are in the mechanics,
    others in the emulation. commands (n, N) m/s at the web, boundary (n, 2) upstream strain and downstream tension (N),
    a row each cycle. state: (S,) or (B, S) of the model, not changed; without one, at rest. `sensors`: stations by
    name; `forces_N`: by station (n,), on carriages with a stated force. Motion and torques of the result are those of
    the axes; its `state` is the line's.
    Raises ValueError for a cycle that is no multiple of the drives' sample time, or shapes that do not fit.
    """
    many, n = np.array(np.atleast_2d(parameters)), model.axis_count
    if commands.ndim != 2 or commands.shape[1] != n or np.shape(boundary) != (len(commands), 2):
        raise ValueError(f"commands {commands.shape}, boundary {np.shape(boundary)}, expected (n, {n}) and (n, 2)")
    of_line = Layout.of(many[0])
    if state is None:
        lines = np.array([start_state(one, model) for one in many])
    else:
        lines = np.array(np.broadcast_to(np.atleast_2d(state), (len(many), of_line.state_size)), order="C")
    rigs, rows = rigs_of(emulation, model, many), lay.driven_rows(many[0])
    layout = Layout.of(rigs[0])
    starts = _starts(layout, rigs, many, lines, boundary[0])
    for one, line in zip(many, lines, strict=True):
        line_follower.hold(one)
        lay.refresh_modes(one, line)
    axes = range(1, n + 1)
    per_m = np.array([model.motor_rad_per_m(axis) for axis in axes])
    pulls = np.array([float(model.carries_web_load(axis)) for axis in axes]) / per_m
    sensor_rows = np.array(_rows_of(model, sensors), np.int64)
    sample_s = many.item(0, lay.W_SAMPLE_TIME_S)
    samples = samples_per(emulation.cycle_s, sample_s)
    out = np.empty((len(many), len(commands), layout.output_size + 2 * of_line.spans + len(sensor_rows)))
    at_motors, limits = np.ascontiguousarray(commands * per_m), np.ascontiguousarray(boundary, dtype=np.float64)
    lead, longest_s = lead_s(model, emulation.cycle_s), line_follower.step_s(model)

    stations = {each.station.name: each.station for each in model.carriages}
    pushed, bases = np.array(_rows_of(model, [*forces_N]), np.int64), np.array([stations[k].force_N for k in forces_N])
    forces = np.column_stack([*forces_N.values()]) if forces_N else np.empty((len(commands), 0))

    def run(share: slice) -> None:
        _simulate(
            rigs[share], starts[share], _rig_inputs(layout, n), layout.new_work(), many[share], lines[share],
            of_line.new_inputs(), of_line.new_work(), np.array(rows, np.int64), sensor_rows, pulls, at_motors, limits,
            samples, emulation.cycle_s, lead, longest_s, pushed, forces, bases, out[share],
        )  # fmt: skip

    on_all_cores(run, len(many))
    if np.ndim(parameters) == 1:
        out, lines = out[0], lines[0]
    of_rig, k = layout.output_size, of_line.spans
    x, v, tau = (out[..., layout.columns[name]][..., :n] for name in ("x_m", "v_m_s", "tau_Nm"))
    tension, strain = out[..., of_rig : of_rig + k], out[..., of_rig + k : of_rig + 2 * k]
    sensors_m = out[..., of_rig + 2 * k :] if len(sensors) else None
    return Simulation(x, v, tau, tension, strain, lines, sensors_m)


def _rig_inputs(layout: Layout, axes: int) -> Vector:
    """Inputs of a rig: its `axes` in velocity mode, its load motors in torque mode."""
    inputs = layout.new_inputs()
    motors = layout.motor_inputs(inputs)
    motors[:axes, lay.UM_MODE] = MotorMode.VELOCITY
    motors[axes:, lay.UM_MODE] = MotorMode.TORQUE
    return inputs


def rigs_of(emulation: Emulation, model: ModelParameters, many: Vector) -> Vector:
    """Rig parameters (B, P) for models (B, P), with the models' effects on axes and drives."""
    without_effects = model.model_copy(update={"effects": ()})
    # Their rotors are included in the model's roller inertia.
    load_motors = [
        coupled.model_copy(update={"motor": coupled.motor.model_copy(update={"inertia_kg_m2": 0.0})})
        for coupled in emulation.load_motors
    ]
    template = pack_rig(RigParameters.matching(without_effects, load_motors))
    rigs = np.tile(template, (len(many), 1))
    layout, of_model, driven = Layout.of(template), Layout.of(many[0]), list(lay.driven_rows(many[0]))
    for stand, parameters in zip(rigs, many, strict=True):
        layout.axis_rows(stand)[:, lay.A_FIXED :] = of_model.axis_rows(parameters)[driven, lay.A_FIXED :]
        motors = layout.motor_rows(stand)[: layout.axes]
        motors[:] = of_model.motor_rows(parameters)[driven]
        motors[:, lay.M_AXIS] = np.arange(layout.axes)
    return rigs


def _starts(layout: Layout, rigs: Vector, many: Vector, lines: Vector, boundary: Vector) -> Vector:
    """States (B, S) of the rigs for states `lines` of the models. `boundary` (2,): upstream strain and downstream
    tension (N) at the start."""
    of_model = Layout.of(many[0])
    rows = np.array(lay.driven_rows(many[0]))
    n, axes, k = len(rows), of_model.axes, of_model.spans
    starts = np.zeros((len(many), layout.state_size))
    for stand, start, parameters, line in zip(rigs, starts, many, lines, strict=True):
        y = of_model.y(line)
        layout.y(start)[:] = y[: 4 * axes].reshape(4, axes)[:, rows].ravel()
        motors = layout.motor_states(start)
        motors[:n] = of_model.motor_states(line)[rows]
        if np.any(y[axes : 2 * axes]):  # running: the load motors already have torque
            strain = y[4 * axes + k :] / y[4 * axes : 4 * axes + k] - 1.0
            of_spans = of_model.span_rows(parameters)
            tension = strain * of_spans[:, lay.SP_MODULUS_PA] * of_spans[:, lay.SP_SECTION_M2]
            around = np.array([boundary[0] * parameters[lay.W_UPSTREAM_STIFFNESS_N], *tension, boundary[1]])
            of_loads = layout.motor_rows(stand)[n:]
            loaded = rows[of_loads[:, lay.M_AXIS].astype(int)]
            pull = (around[loaded + 1] - around[loaded]) / of_loads[:, lay.M_RAD_PER_M]
            motors[n:, [lay.SM_TORQUE_NM, lay.SM_COMMAND_NM, lay.SM_INTEGRAL_NM]] = pull[:, np.newaxis]
        lay.refresh_modes(stand, start)
    return starts


def _rows_of(model: ModelParameters, names: Sequence[str]) -> list[int]:
    """Rows of carriages and reels among the axes of a line, by name."""
    rollers = model.line_rollers
    rows = {station_name(roller.station): row for row, roller in enumerate(rollers)}
    rows |= {each.station.name: row for row, each in enumerate(model.carriages, len(rollers))}
    return [rows[name] for name in names]
